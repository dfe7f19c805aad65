// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/io/cloud.hpp>

namespace loopwise {

/// The scans of a mission, read when they are asked for and kept, least recently used out first, within a
/// bound of memory. Safe to use from any number of threads; threads that ask for one scan at once have it
/// read once. Copies share the same scans and memory.
class LOOPWISE_EXPORT ScanStore {
 public:
  static constexpr std::size_t kDefaultMaxBytes = std::size_t{512} << 20;  ///< 512 MiB.

  /// No scans.
  ScanStore() : ScanStore(std::map<Key, std::filesystem::path>{}) {}

  /// Scans in files that read_cloud() understands. Nothing is read before it is asked for.
  explicit ScanStore(std::map<Key, std::filesystem::path> files, std::size_t max_bytes = kDefaultMaxBytes,
                     BinLayout bin_layout = BinLayout::kAuto);

  /// Scans from elsewhere: `source` is asked for one of `keys` when it is needed and not in memory.
  ScanStore(const std::vector<Key>& keys, ScanLoader source, std::size_t max_bytes = kDefaultMaxBytes);

  /// As a ScanLoader, with the flaws of what it read.
  using CloudSource = std::function<CloudFile(Key)>;
  /// Scans from elsewhere whose flaws are to be counted. The source must be safe to call from several
  /// threads.
  ScanStore(const std::vector<Key>& keys, CloudSource source, std::size_t max_bytes = kDefaultMaxBytes);

  /// A scan of another store.
  struct Part {
    std::shared_ptr<const ScanStore> store;  ///< Holds it.
    Key key = 0;                             ///< Under this key.
  };
  /// Scans of other stores under new keys. They stay in the memory of those stores.
  explicit ScanStore(std::map<Key, Part> parts);

  /// Whether the node has a scan.
  [[nodiscard]] bool has(Key key) const;
  /// Ascending.
  [[nodiscard]] std::vector<Key> keys() const;
  /// Number of scans.
  [[nodiscard]] std::size_t size() const;
  /// Whether there is no scan.
  [[nodiscard]] bool empty() const { return size() == 0; }

  /// The scan of the node, or null if it has none. A scan larger than the bound is handed out but not kept.
  /// \throws InputError if it cannot be read or does not lie about its sensor (PointCloud::origin), the same
  /// each time: a broken file is looked at once.
  [[nodiscard]] std::shared_ptr<const PointCloud> load(Key key) const;

  /// Flaws and failures of the scans read so far, in the order of their keys, however many threads read them.
  /// "scan is damaged" is what stands in the file, and will be so tomorrow; "scan cannot be read" is all
  /// else.
  [[nodiscard]] Problems problems() const;

  /// Memory of the scans kept now; what callers still hold is not counted.
  [[nodiscard]] std::size_t bytes() const;

  /// load() as a function that keeps the scans alive by itself.
  [[nodiscard]] ScanLoader loader() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace loopwise
