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

/// The scans of a mission, read on demand and kept within a bound of memory; the least recently used scan is
/// removed first. Thread-safe: concurrent requests for one scan read it once. Copies share the same scans and
/// memory.
class LOOPWISE_EXPORT ScanStore {
 public:
  static constexpr std::size_t kDefaultMaxBytes = std::size_t{512} << 20;  ///< 512 MiB.

  /// No scans.
  ScanStore() : ScanStore(std::map<Key, std::filesystem::path>{}) {}

  /// Scans in files of read_cloud(). Files are read on demand.
  explicit ScanStore(std::map<Key, std::filesystem::path> files, std::size_t max_bytes = kDefaultMaxBytes,
                     BinLayout bin_layout = BinLayout::kAuto);

  /// Scans from another source: `source` is called with one of `keys` when the scan is needed and not in
  /// memory.
  ScanStore(const std::vector<Key>& keys, ScanLoader source, std::size_t max_bytes = kDefaultMaxBytes);

  /// A ScanLoader that also counts the flaws of the scan.
  using CloudSource = std::function<CloudFile(Key)>;
  /// Scans from another source that counts flaws. The source must be thread-safe.
  ScanStore(const std::vector<Key>& keys, CloudSource source, std::size_t max_bytes = kDefaultMaxBytes);

  /// A scan of another store.
  struct Part {
    std::shared_ptr<const ScanStore> store;  ///< The store of the scan.
    Key key = 0;                             ///< Its key there.
  };
  /// Scans of other stores under new keys. They remain in the memory of those stores.
  explicit ScanStore(std::map<Key, Part> parts);

  /// Whether the node has a scan.
  [[nodiscard]] bool has(Key key) const;
  /// Ascending.
  [[nodiscard]] std::vector<Key> keys() const;
  /// Number of scans.
  [[nodiscard]] std::size_t size() const;
  /// Whether there is no scan.
  [[nodiscard]] bool empty() const { return size() == 0; }

  /// The scan of the node, or null if it has no scan. A scan larger than the bound is returned but not kept.
  /// \throws InputError if it cannot be read or is in world coordinates (PointCloud::origin), the same each
  /// time: a broken file is read once.
  [[nodiscard]] std::shared_ptr<const PointCloud> load(Key key) const;

  /// Flaws and failures of the scans read so far, in the order of their keys, for any number of threads.
  /// "scan is damaged" is a permanent fault of the file; "scan cannot be read" is any other failure.
  [[nodiscard]] Problems problems() const;

  /// Memory of the scans in the store; scans that only callers hold do not count.
  [[nodiscard]] std::size_t bytes() const;

  /// load() as a function that keeps the scans alive by itself.
  [[nodiscard]] ScanLoader loader() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace loopwise
