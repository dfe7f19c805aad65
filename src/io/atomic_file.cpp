// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/atomic_file.hpp>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

namespace fs = std::filesystem;

/// A file descriptor that the destructor closes.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  [[nodiscard]] int get() const { return fd_; }
  /// Some errors of a full disk appear only at close().
  [[nodiscard]] bool close() {
    const int result = ::close(fd_);
    fd_ = -1;
    return result == 0;
  }

 private:
  int fd_;
};

[[noreturn]] void fail(const fs::path& path, int error) {
  throw IoError(path.string(), std::strerror(error));
}

/// \returns 0 or the system's error number.
int write_all(int fd, std::string_view contents) {
  while (!contents.empty()) {
    const ssize_t written = ::write(fd, contents.data(), contents.size());
    if (written < 0) {
      if (errno == EINTR) continue;
      return errno;
    }
    contents.remove_prefix(static_cast<std::size_t>(written));
  }
  return 0;
}

/// \returns 0 or the system's error number. A file without a disk, such as a pipe, has nothing to flush.
template <class System>
int flush(int fd, const System& system) {
  while (system(fd) != 0) {
    if (errno == EINVAL || errno == ENOTSUP)
      return 0;  // EROFS stays an error: a disk that fails becomes read-only
    if (errno != EINTR) return errno;
  }
  return 0;
}

/// Descriptor of the standard output or error if it writes to this file, otherwise -1.
int stream_to(const struct stat& file) {
  for (const int fd : {STDOUT_FILENO, STDERR_FILENO}) {
    struct stat stream {};
    if (::fstat(fd, &stream) == 0 && stream.st_dev == file.st_dev && stream.st_ino == file.st_ino) return fd;
  }
  return -1;
}

/// Follows a symbolic link, so that the file is replaced and not the link.
std::string resolved(const fs::path& path) {
  const std::unique_ptr<char, decltype(&std::free)> whole(::realpath(path.c_str(), nullptr), std::free);
  if (!whole && errno == ENOMEM) throw std::bad_alloc();
  return whole ? whole.get() : path.string();
}

}  // namespace

std::string read_file(const fs::path& path) {
  Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) fail(path, errno);
  struct stat status {};
  if (::fstat(file.get(), &status) != 0) fail(path, errno);
  if (S_ISDIR(status.st_mode)) throw IoError(path.string(), "is a folder, expected a file");
  std::string contents(status.st_size > 0 ? static_cast<std::size_t>(status.st_size) : 0, '\0');
  std::size_t filled = 0;
  while (true) {
    // Pipes have no size, and a file may grow while it is read.
    if (filled == contents.size()) {
      char more[1 << 16];
      const ssize_t count = ::read(file.get(), more, sizeof(more));
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) fail(path, errno);
      if (count == 0) break;
      contents.append(more, static_cast<std::size_t>(count));
      filled = contents.size();
      continue;
    }
    const ssize_t count = ::read(file.get(), contents.data() + filled, contents.size() - filled);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(path, errno);
    if (count == 0) break;
    filled += static_cast<std::size_t>(count);
  }
  contents.resize(filled);
  return contents;
}

void write_file(const fs::path& path, std::string_view contents, Flush when) {
  struct stat status {};
  const bool exists = ::stat(path.c_str(), &status) == 0;
  if (exists && S_ISDIR(status.st_mode))
    throw IoError(path.string(), "is a folder, cannot be written as a file");
  if (exists && !S_ISREG(status.st_mode)) {
    Descriptor device(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
    if (device.get() < 0) fail(path, errno);
    if (const int error = write_all(device.get(), contents)) fail(path, error);
    return;
  }
  if (const int stream = exists ? stream_to(status) : -1; stream >= 0) {
    if (const int error = write_all(stream, contents)) fail(path, error);
    return;
  }
  // Names are text, because a path of libstdc++ cannot be destroyed after an allocation failure during a
  // change.
  const std::string target = exists ? resolved(path) : path.string();
  const std::size_t name = target.rfind('/') + 1;
  // The folder keeps the names of files, so it is flushed as well. This needs permission to read the folder.
  const std::string folder = name > 0 ? target.substr(0, name) : ".";
  Descriptor names(when == Flush::kNow ? ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC) : -1);
  if (when == Flush::kNow && names.get() < 0 && errno != EACCES) fail(path, errno);
  std::string temporary;
  int fd = -1;
  for (unsigned attempt = 0; fd < 0; ++attempt) {
    // A file name has at most 255 bytes, so the original name is cut.
    temporary = target.substr(0, name) + "." + target.substr(name, 200) + "." + std::to_string(::getpid()) +
                "-" + std::to_string(attempt) + ".tmp";
    fd = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd < 0 && errno != EEXIST) fail(path, errno);
    if (fd < 0 && attempt == 1000) fail(path, EEXIST);
  }
  Descriptor file(fd);
  int error = write_all(file.get(), contents);
  if (error == 0 && exists && ::fchmod(file.get(), status.st_mode & 07777) != 0) error = errno;
  // The contents are flushed before the rename. Otherwise a power loss could leave an empty file.
  if (error == 0 && when == Flush::kNow) error = flush(file.get(), ::fsync);
  if (!file.close() && error == 0) error = errno;
  if (error == 0 && ::rename(temporary.c_str(), target.c_str()) != 0) error = errno;
  if (error != 0) {
    ::unlink(temporary.c_str());
    fail(path, error);
  }
  if (names.get() >= 0) error = flush(names.get(), ::fsync);
  if (error != 0) fail(path, error);
}

std::string plain_file_name(std::string_view name) {
  std::string out(name.substr(0, 100));
  for (char& c : out) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-';
    if (!plain) c = '_';
  }
  return out;
}

void flush_file(const fs::path& path) {
  Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) {
    const int error = errno;
    std::error_code ignored;
    if (error == EACCES && fs::is_directory(path, ignored)) return;  // may be written to, but not read
    fail(path, error);
  }
  if (const int error = flush(file.get(), ::fsync)) fail(path, error);
}

void flush_file_system(const fs::path& path) {
#ifdef __linux__
  Descriptor any(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (any.get() < 0) fail(path, errno);
  if (const int error = flush(any.get(), ::syncfs)) fail(path, error);
#else
  static_cast<void>(path);
  ::sync();
#endif
}

}  // namespace loopwise
