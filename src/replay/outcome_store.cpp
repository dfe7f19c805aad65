// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/outcome_store.hpp>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <new>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/registration/task.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/result_codec.hpp>

#include "byte_stream.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

// A file is a sequence of records: mark, size of the payload, key, checksum, payload. Numbers have this
// machine's byte order; a machine with another byte order does not find the mark and reads no records.
constexpr std::uint32_t kMark = 0x3157'4f4c;  // "LOW1"
constexpr std::size_t kHeaderBytes = 4 + 4 + 16 + 8;
constexpr std::uint32_t kMaxPayload = 1U << 20;

std::uint64_t checksum(const ContentHash& key, const char* payload, std::size_t size) {
  return ContentHasher().integer(key.high).integer(key.low).bytes(payload, size).finish().high;
}

/// Decodes a payload with a valid checksum; nothing if a later version wrote it.
std::optional<RegistrationResult> result_of(std::string_view payload, const LoopCandidate& candidate) {
  try {
    return unpack_result(payload, candidate);
  } catch (const InputError&) {
    return std::nullopt;
  }
}

/// The number in a file name: 12 for "outcomes-00000012.bin".
std::optional<std::uint64_t> number_of(const fs::path& path) {
  const std::string name = path.filename().string();
  unsigned long long number = 0;
  int read = 0;
  if (std::sscanf(name.c_str(), "outcomes-%8llu.bin%n", &number, &read) != 1) return std::nullopt;
  if (static_cast<std::size_t>(read) != name.size()) return std::nullopt;
  return number;
}

fs::path file_path(const fs::path& folder, std::uint64_t number) {
  std::string digits = std::to_string(number);
  digits.insert(0, 8 - std::min<std::size_t>(8, digits.size()), '0');
  return folder / ("outcomes-" + digits + ".bin");
}

/// The store's files, oldest first. Empty if the folder does not exist.
std::vector<std::uint64_t> files_in(const fs::path& folder) {
  std::vector<std::uint64_t> numbers;
  std::error_code ignored;
  for (fs::directory_iterator entry(folder, ignored), end; !ignored && entry != end;
       entry.increment(ignored)) {
    if (const auto number = number_of(entry->path())) numbers.push_back(*number);
  }
  std::sort(numbers.begin(), numbers.end());
  return numbers;
}

bool write_whole(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return true;
}

}  // namespace

/// An open file of the store. It stays readable after its name is deleted.
class OutcomeStore::File {
 public:
  File(fs::path path, int flags)
      : path_(std::move(path)), fd_(::open(path_.c_str(), flags | O_CLOEXEC, 0666)) {}
  ~File() {
    if (fd_ >= 0) ::close(fd_);  // this also releases the lock
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  [[nodiscard]] bool open() const { return fd_ >= 0; }
  [[nodiscard]] int fd() const { return fd_; }
  [[nodiscard]] const fs::path& path() const { return path_; }
  /// Locks the file exclusively. \returns false if another process holds the lock
  [[nodiscard]] bool lock() const { return ::flock(fd_, LOCK_EX | LOCK_NB) == 0; }
  void unlock() const { ::flock(fd_, LOCK_UN); }
  [[nodiscard]] bool deleted() const {
    struct stat about {};
    return ::fstat(fd_, &about) != 0 || about.st_nlink == 0;
  }
  [[nodiscard]] std::uint64_t size() const {
    struct stat about {};
    return ::fstat(fd_, &about) == 0 ? static_cast<std::uint64_t>(about.st_size) : 0;
  }
  /// Reads the requested bytes, as far as they exist.
  [[nodiscard]] std::string read(std::uint64_t offset, std::size_t size) const {
    std::string bytes(size, '\0');
    std::size_t done = 0;
    while (done < size) {
      const ssize_t got = ::pread(fd_, bytes.data() + done, size - done, static_cast<off_t>(offset + done));
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) break;
      done += static_cast<std::size_t>(got);
    }
    bytes.resize(done);
    return bytes;
  }

 private:
  fs::path path_;
  int fd_;
};

OutcomeStore::OutcomeStore(fs::path folder, const OutcomeStoreOptions& options) : folder_(std::move(folder)) {
  validate(options);
  max_bytes_ = static_cast<std::uint64_t>(options.max_mb * 1e6);
  file_bytes_ = max_bytes_ / 16;
  std::error_code failure;
  fs::create_directories(folder_, failure);
  if (failure) throw IoError(folder_.string(), failure.message());
  if (!fs::is_directory(folder_)) throw IoError(folder_.string(), "is not a folder");
  for (const std::uint64_t number : files_in(folder_)) {
    const auto file = std::make_shared<const File>(file_path(folder_, number), O_RDONLY);
    if (file->open()) {
      load(file);
    } else if (errno != ENOENT) {  // ENOENT: another process has just deleted it
      throw IoError(file->path().string(), std::strerror(errno));
    }
  }
  statistics_.found_at_start = places_.size();
}

OutcomeStore::~OutcomeStore() = default;

void OutcomeStore::load(const std::shared_ptr<const File>& file) {
  const std::string bytes = file->read(0, file->size());
  std::size_t at = 0, passed_over = 0;
  bool unfinished = false;  // the skipped bytes begin like a record that ends beyond the file
  while (at < bytes.size()) {
    bool ends_beyond = false;
    const auto record = [&]() -> std::optional<std::uint32_t> {
      const std::size_t rest = bytes.size() - at;
      ends_beyond = std::memcmp(bytes.data() + at, &kMark, std::min(rest, sizeof kMark)) == 0;
      if (rest < kHeaderBytes) return std::nullopt;
      ByteReader header(std::string_view(bytes).substr(at, kHeaderBytes));
      const auto mark = header.get<std::uint32_t>(), size = header.get<std::uint32_t>();
      ends_beyond = mark == kMark && size <= kMaxPayload && rest - kHeaderBytes < size;
      if (mark != kMark || size > kMaxPayload || ends_beyond) return std::nullopt;
      ContentHash key;
      key.high = header.get<std::uint64_t>();
      key.low = header.get<std::uint64_t>();
      if (header.get<std::uint64_t>() != checksum(key, bytes.data() + at + kHeaderBytes, size)) {
        return std::nullopt;
      }
      places_[key] = {file, at + kHeaderBytes, size};
      return size;
    }();
    if (record || (ends_beyond && !unfinished)) {
      statistics_.damaged_bytes += passed_over;
      passed_over = 0;
      unfinished = !record;
    }
    if (record) {
      at += kHeaderBytes + *record;
    } else {  // look for the next record
      ++at;
      ++passed_over;
    }
  }
  // An unfinished record is not damage: a process is writing it now, or was killed while writing.
  if (!unfinished) statistics_.damaged_bytes += passed_over;
}

std::optional<RegistrationResult> OutcomeStore::read(const ContentHash& key, const Place& place,
                                                     const LoopCandidate& candidate) const {
  const std::string bytes = place.file->read(place.offset - 8, place.size + 8);  // checksum and payload
  if (bytes.size() != place.size + 8) return std::nullopt;
  ByteReader in(bytes);
  if (in.get<std::uint64_t>() != checksum(key, bytes.data() + 8, place.size)) return std::nullopt;
  return result_of(std::string_view(bytes).substr(8), candidate);
}

RegistrationResult OutcomeStore::get(const ContentHash& key, const LoopCandidate& candidate,
                                     const std::function<RegistrationResult()>& compute) {
  {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      done_.wait(lock, [&] { return being_computed_.count(key) == 0; });
      const auto found = places_.find(key);
      if (found == places_.end()) break;
      const Place place = found->second;
      lock.unlock();
      auto result = read(key, place, candidate);
      lock.lock();
      if (result) {
        ++statistics_.hits;
        return *std::move(result);
      }
      places_.erase(key);  // the file has changed since the store was opened
    }
    being_computed_.insert(key);
  }
  const auto finish = [&](const RegistrationResult* result) {
    const std::lock_guard<std::mutex> lock(mutex_);
    being_computed_.erase(key);
    done_.notify_all();  // waiting calls continue when the mutex is free
    if (!result) return;
    ++statistics_.computed;
    if (depends_on_circumstances(*result)) return;
    try {
      append(key, *result);
    } catch (const std::bad_alloc&) {  // the result is valid even if it cannot be stored
      statistics_.problem = "out of memory";
    }
  };
  try {
    RegistrationResult result = compute();
    finish(&result);
    return result;
  } catch (...) {
    finish(nullptr);
    throw;
  }
}

void OutcomeStore::append(const ContentHash& key, const RegistrationResult& result) {
  if (!statistics_.problem.empty()) return;
  const std::string payload = pack_result(result);
  if (payload.size() > kMaxPayload) return;
  ByteWriter header;
  header.put(kMark).put(static_cast<std::uint32_t>(payload.size())).put(key.high).put(key.low);
  header.put(checksum(key, payload.data(), payload.size()));
  const std::string record = header.take() + payload;

  if (!writing_ || writing_->deleted() || writing_->size() + record.size() > file_bytes_) {
    open_for_writing();
    if (!writing_) return;
  }
  const std::uint64_t offset = writing_->size();  // no other process appends, because the file is locked
  if (!write_whole(writing_->fd(), record)) {
    statistics_.problem = writing_->path().string() + ": " + std::strerror(errno);
    return;
  }
  places_[key] = {writing_, offset + kHeaderBytes, static_cast<std::uint32_t>(payload.size())};
}

void OutcomeStore::open_for_writing() {
  constexpr int kAppend = O_RDWR | O_APPEND;
  const auto full = [this](const File& file) { return 2 * file.size() > file_bytes_; };
  if (writing_) writing_->unlock();  // the file stays open for reading
  writing_.reset();
  std::error_code failure;
  fs::create_directories(folder_, failure);
  std::vector<std::uint64_t> numbers = files_in(folder_);
  const std::uint64_t next = numbers.empty() ? 1 : numbers.back() + 1;
  // Continues a file of a process that has ended. Otherwise every run of several processes would add new
  // files.
  std::reverse(numbers.begin(), numbers.end());
  for (std::size_t i = 0; i < numbers.size() && !writing_; ++i) {
    auto file = std::make_shared<File>(file_path(folder_, numbers[i]), kAppend);
    if (file->open() && !full(*file) && file->lock() && !file->deleted() && !full(*file)) {
      writing_ = std::move(file);
    }
  }
  constexpr std::uint64_t kTries = 1000;  // other processes may take the same number at the same time
  for (std::uint64_t number = next; !writing_ && number < next + kTries; ++number) {
    auto file = std::make_shared<File>(file_path(folder_, number), kAppend | O_CREAT | O_EXCL);
    if (!file->open()) {
      if (errno == EEXIST) continue;
      statistics_.problem = file->path().string() + ": " + std::strerror(errno);
      return;
    }
    if (file->lock()) {
      if (!file->deleted()) writing_ = std::move(file);
    } else if (errno != EWOULDBLOCK) {  // the file system does not support locks
      statistics_.problem = file->path().string() + ": cannot be locked: " + std::strerror(errno);
      ::unlink(file->path().c_str());
      return;
    }
  }
  if (!writing_) {
    statistics_.problem = folder_.string() + ": no file in it can be written";
    return;
  }
  drop_oldest(writing_.get());
}

void OutcomeStore::drop_oldest(const File* own) {
  std::vector<std::pair<fs::path, std::uint64_t>> others;
  std::uint64_t total = file_bytes_;  // the final size of this process's file
  for (const std::uint64_t number : files_in(folder_)) {
    const fs::path path = file_path(folder_, number);
    std::error_code ignored;
    const std::uint64_t size = fs::file_size(path, ignored);
    if (ignored || path == own->path()) continue;
    others.emplace_back(path, size);
    total += size;
  }
  for (const auto& [path, size] : others) {
    if (total <= max_bytes_) return;
    const File file(path, O_RDWR);
    if (!file.open() || !file.lock()) continue;  // another process writes to it
    std::error_code ignored;
    if (fs::remove(path, ignored)) total -= size;
  }
}

OutcomeStoreStatistics OutcomeStore::statistics() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return statistics_;
}

// ---- registrar

StoredRegistrar::StoredRegistrar(std::shared_ptr<const Registrar> registrar,
                                 std::shared_ptr<OutcomeStore> store, ScanLoader scans,
                                 std::string_view context)
    : registrar_(std::move(registrar)),
      store_(std::move(store)),
      scans_(std::move(scans)),
      context_(ContentHasher().text(context).finish()) {
  if (!registrar_ || !store_ || !scans_) {
    throw InputError("StoredRegistrar needs a registrar, a store and scans");
  }
}

std::optional<ContentHash> StoredRegistrar::scan_hash(Key key) const {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (const auto found = scan_hashes_.find(key); found != scan_hashes_.end()) return found->second;
  }
  std::shared_ptr<const PointCloud> cloud;
  try {
    cloud = scans_(key);
  } catch (const Error&) {  // the registrar reports the error in its result
    return std::nullopt;
  }
  if (!cloud) return std::nullopt;
  ContentHasher hasher;
  const auto add = [&hasher](const auto& values) {
    hasher.integer(values.size());
    hasher.bytes(values.data(), values.size() * sizeof(values[0]));
  };
  add(cloud->points);
  add(cloud->normals);
  add(cloud->intensities);
  const ContentHash hash = hasher.finish();
  const std::lock_guard<std::mutex> lock(mutex_);
  scan_hashes_.emplace(key, hash);
  return hash;
}

std::optional<ContentHash> StoredRegistrar::key_of(const RegistrationTask& task) const {
  const ContentHash of_task = hash_of(task);
  ContentHasher hasher;
  hasher.integer(context_.high).integer(context_.low).integer(of_task.high).integer(of_task.low);
  for (const std::vector<SubmapMember>* members : {&task.source, &task.target}) {
    for (const SubmapMember& member : *members) {
      const std::optional<ContentHash> scan = scan_hash(member.key);
      if (!scan) return std::nullopt;
      hasher.integer(scan->high).integer(scan->low);
    }
  }
  return hasher.finish();
}

RegistrationResult StoredRegistrar::compute(const RegistrationTask& task) const {
  const std::optional<ContentHash> key = key_of(task);
  if (!key) return registrar_->compute(task);
  return store_->get(*key, task.candidate, [&] { return registrar_->compute(task); });
}

}  // namespace loopwise
