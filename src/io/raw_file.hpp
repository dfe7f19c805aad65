// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A file of bytes that can be read from any position. Private to io.
#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>

#include <loopwise/core/error.hpp>

namespace loopwise {

/// A regular file, open for reading. \throws IoError if it is not a regular file or cannot be read
class RawFile {
 public:
  explicit RawFile(const std::filesystem::path& path)
      : path_(path), fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    if (fd_ < 0) throw IoError(path.string(), std::strerror(errno));
    struct stat status {};
    if (::fstat(fd_, &status) != 0 || !S_ISREG(status.st_mode)) {
      ::close(fd_);
      throw IoError(path.string(), "is not a regular file");
    }
    size_ = static_cast<std::uint64_t>(status.st_size);
  }
  ~RawFile() { ::close(fd_); }
  RawFile(const RawFile&) = delete;
  RawFile& operator=(const RawFile&) = delete;

  [[nodiscard]] std::uint64_t size() const { return size_; }
  /// The caller ensures that the file has these bytes.
  void read(std::uint64_t at, std::size_t count, std::string& out) const {
    out.resize(count);
    for (std::size_t done = 0; done < count;) {
      const ssize_t got = ::pread(fd_, out.data() + done, count - done, static_cast<off_t>(at + done));
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0)
        throw IoError(path_.string(), got < 0 ? std::strerror(errno) : "became shorter while being read");
      done += static_cast<std::size_t>(got);
    }
  }

 private:
  std::filesystem::path path_;
  int fd_ = -1;
  std::uint64_t size_ = 0;
};

}  // namespace loopwise
