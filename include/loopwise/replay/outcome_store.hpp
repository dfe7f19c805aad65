// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Outcomes of registrations kept on disk. A registration is by far the dearest step of a run, and its
/// outcome depends on its task and scans alone: kept once, it serves every method, budget and rerun that
/// comes to the same task.
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
  double max_mb = 4096.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_mb", self.max_mb, at_least(1.0),
          "Outcomes beyond this size on disk go, the oldest first, MB.");
  }
};

/// What a store has done since it was opened.
struct OutcomeStoreStatistics {
  std::size_t found_at_start = 0;  ///< Outcomes on disk when it was opened.
  /// Of its files, that hold no outcome: cut short or changed. Never used. The beginning of a record at a
  /// file's end is none: its writer may be at it.
  std::size_t damaged_bytes = 0;
  std::size_t hits = 0;      ///< Outcomes that were there when they were asked for.
  std::size_t computed = 0;  ///< Outcomes that were not.
  std::string problem;       ///< Why nothing is kept any more (a full disk); empty while all is well.
};

/// A folder of outcomes by the hash of all that they depend on.
///
/// Files are only ever appended to, a whole record at a time with a checksum; a record that a kill cut short
/// or a disk changed is passed over and computed again. Any number of processes may use one folder at once:
/// each appends to a file that it has locked, and reads what the others had written when it opened the store.
/// The folder, or any file of it, may be deleted at any moment: what was open stays readable, the rest is
/// computed again. Thread-safe.
class LOOPWISE_EXPORT OutcomeStore {
 public:
  /// Makes the folder if it does not exist. \throws OptionError; IoError if it cannot be made or read.
  explicit OutcomeStore(std::filesystem::path folder, const OutcomeStoreOptions& options = {});
  ~OutcomeStore();
  OutcomeStore(const OutcomeStore&) = delete;
  OutcomeStore& operator=(const OutcomeStore&) = delete;

  /// The outcome kept under `key`, or else that of `compute`, which is then kept unless it
  /// depends_on_circumstances(). Threads that ask for one key at once have it computed once. \throws what
  /// `compute` throws; nothing is kept then.
  [[nodiscard]] RegistrationResult get(const ContentHash& key, const LoopCandidate& candidate,
                                       const std::function<RegistrationResult()>& compute);

  /// What it has done since it was opened.
  [[nodiscard]] OutcomeStoreStatistics statistics() const;

 private:
  class File;
  struct Place {
    std::shared_ptr<const File> file;
    std::uint64_t offset = 0;  ///< Of the payload.
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
  std::uint64_t file_bytes_;  ///< A file that has reached this is followed by another.

  mutable std::mutex mutex_;
  std::condition_variable done_;
  std::unordered_map<ContentHash, Place> places_;
  std::unordered_set<ContentHash> being_computed_;
  std::shared_ptr<File> writing_;
  OutcomeStoreStatistics statistics_;
};

/// A registrar that takes from a store what is there. Its results are those of the registrar that it stands
/// before, wall times apart: a kept outcome has the times of its computation.
class LOOPWISE_EXPORT StoredRegistrar final : public Registrar {
 public:
  /// `context` names all that outcomes depend on besides tasks and scans, see registration_context().
  /// \throws InputError on a null pointer or an empty loader.
  StoredRegistrar(std::shared_ptr<const Registrar> registrar, std::shared_ptr<OutcomeStore> store,
                  ScanLoader scans, std::string_view context);

  [[nodiscard]] std::string_view name() const override { return registrar_->name(); }
  /// A task with a scan that is missing or unreadable is computed and not kept, and so is what throws.
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override;

  /// The key of a task's outcome; none if a scan is missing or unreadable.
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
