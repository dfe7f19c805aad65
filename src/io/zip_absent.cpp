// SPDX-License-Identifier: BSD-3-Clause
// Replaces zip_archive.cpp in a build without zip archives.
#include <loopwise/core/error.hpp>

#include "zip_archive.hpp"

namespace loopwise {

struct ZipArchive::State {
  std::vector<std::string> names;
};

bool ZipArchive::available() {
  return false;
}

ZipArchive::ZipArchive(const std::filesystem::path& file) : state_(std::make_shared<State>()) {
  throw InputError(file.string() +
                   ": this program was built without zip archives (LOOPWISE_WITH_ZIP; Debian: libzip-dev)");
}

const std::vector<std::string>& ZipArchive::names() const {
  return state_->names;
}

std::uint64_t ZipArchive::size(std::size_t) const {
  return 0;
}

std::string ZipArchive::read(std::size_t) const {
  return {};
}

void ZipArchive::read(std::size_t, const std::function<void(std::string_view)>&) const {}

}  // namespace loopwise
