// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Stores outcomes of registrations on disk. A registration is by far the most expensive step of a run, and
/// its outcome depends only on its task and scans. So a stored outcome serves every method, budget and rerun
/// with the same task.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Bound of a store.
struct OutcomeStoreOptions {
  /// Maximum size of the outcomes on disk, MB. Beyond it, the oldest are removed.
  double max_mb = 4096.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_mb", self.max_mb, at_least(1.0));
  }
};

/// Statistics of a store since it was opened.
struct OutcomeStoreStatistics {
  std::size_t found_at_start = 0;  ///< Outcomes on disk when it was opened.
  /// Number of truncated or altered records in its files, which are never used. An incomplete record at a
  /// file's end does not count: it may be in writing.
  std::size_t damaged_bytes = 0;
  std::size_t hits = 0;      ///< Requests with a stored outcome.
  std::size_t computed = 0;  ///< Requests without a stored outcome.
  std::string problem;       ///< Why outcomes are not stored any more (a full disk); empty without an error.
};

/// A folder of outcomes under the hash of all their input.
///
/// Records with a checksum are appended to the files. A truncated or altered record is ignored and computed
/// again. Any number of processes may use one folder at once: each appends to a file that it has locked, and
/// reads the records of the others at the time of opening. The folder, or any file in it, may be deleted at
/// any time: open files stay readable, other outcomes are computed again. Thread-safe.
class LOOPWISE_EXPORT OutcomeStore {
 public:
  /// Makes the folder if it does not exist. \throws OptionError; IoError if it cannot be made or read.
  explicit OutcomeStore(std::filesystem::path folder, const OutcomeStoreOptions& options = {});
  ~OutcomeStore();
  OutcomeStore(const OutcomeStore&) = delete;
  OutcomeStore& operator=(const OutcomeStore&) = delete;

  /// The outcome stored under `key`, or else the result of `compute`. The latter is stored unless it
  /// depends_on_circumstances(). Concurrent requests for one key compute it once. \throws exceptions of
  /// `compute`; nothing is then stored.
  [[nodiscard]] RegistrationResult get(const ContentHash& key, const LoopCandidate& candidate,
                                       const std::function<RegistrationResult()>& compute);

  /// Statistics since it was opened.
  [[nodiscard]] OutcomeStoreStatistics statistics() const;

 private:
  class File;
  struct Place {
    std::shared_ptr<const File> file;
    std::uint64_t offset = 0;  ///< Position of the payload.
    std::uint32_t size = 0;
  };

  void load(const std::shared_ptr<const File>& file);
  [[nodiscard]] std::optional<RegistrationResult> read(const ContentHash& key, const Place& place,
                                                       const LoopCandidate& candidate) const;
  void append(const ContentHash& key, const RegistrationResult& result);
  void open_for_writing();
  void drop_oldest(const File* own);

  std::filesystem::path folder_;
  std::uint64_t max_bytes_;
  std::uint64_t file_bytes_;  ///< A new file starts at this size.

  mutable std::mutex mutex_;
  std::condition_variable done_;
  std::unordered_map<ContentHash, Place> places_;
  std::unordered_set<ContentHash> being_computed_;
  std::shared_ptr<File> writing_;
  OutcomeStoreStatistics statistics_;
};

/// A registrar that uses the stored outcomes. Its results equal those of the wrapped registrar, except for
/// wall times: a stored outcome has the times of its computation.
class LOOPWISE_EXPORT StoredRegistrar final : public Registrar {
 public:
  /// `context` holds all input besides tasks and scans, see registration_context().
  /// \throws InputError on a null pointer or an empty loader.
  StoredRegistrar(std::shared_ptr<const Registrar> registrar, std::shared_ptr<OutcomeStore> store,
                  ScanLoader scans, std::string_view context);

  [[nodiscard]] std::string_view name() const override { return registrar_->name(); }
  /// A task with a missing or unreadable scan is computed and not stored; exceptions are not stored either.
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override;

  /// The key of a task's outcome; empty if a scan is missing or unreadable.
  [[nodiscard]] std::optional<ContentHash> key_of(const RegistrationTask& task) const;

 private:
  [[nodiscard]] std::optional<ContentHash> scan_hash(Key key) const;

  std::shared_ptr<const Registrar> registrar_;
  std::shared_ptr<OutcomeStore> store_;
  ScanLoader scans_;
  ContentHash context_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<Key, ContentHash> scan_hashes_;
};

}  // namespace loopwise
