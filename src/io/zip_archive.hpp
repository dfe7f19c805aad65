// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Zip archives, read without unpacking. Names in an archive never become paths. zip_absent.cpp replaces
/// zip_archive.cpp in a build without zip archives. Private to io.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace loopwise {

class ZipArchive {
 public:
  /// Whether this build reads archives.
  [[nodiscard]] static bool available();

  /// \throws IoError; InputError if it is no archive, is damaged, or this build reads none.
  explicit ZipArchive(const std::filesystem::path& file);

  /// Names of the files as in the archive, in its order. Folders are left out.
  [[nodiscard]] const std::vector<std::string>& names() const;

  /// The contents of the n-th file, checked against its checksum. Memory grows with the output, not with the
  /// size that the archive states. Safe to call from several threads, of which one reads at a time; copies
  /// share the archive. \throws InputError naming archive and file if it is damaged, encrypted or larger than
  /// 1 GiB
  [[nodiscard]] std::string read(std::size_t number) const;

  /// Size in bytes of the n-th file according to the archive; read() gives no more bytes.
  [[nodiscard]] std::uint64_t size(std::size_t number) const;

  /// The same as read(), in pieces and without the bound on the size.
  void read(std::size_t number, const std::function<void(std::string_view)>& piece) const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace loopwise
