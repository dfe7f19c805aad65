// SPDX-License-Identifier: BSD-3-Clause
#include "zip_archive.hpp"

#include <zip.h>

#include <mutex>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kLargestInMemory = std::size_t{1} << 30;

}  // namespace

struct ZipArchive::State {
  struct File {
    zip_uint64_t index;
    zip_uint64_t size;
  };
  ~State() {
    if (zip != nullptr) zip_discard(zip);
  }

  std::string path;
  zip_t* zip = nullptr;
  std::vector<std::string> names;
  std::vector<File> files;  // as names
  std::mutex mutex;
};

bool ZipArchive::available() {
  return true;
}

ZipArchive::ZipArchive(const std::filesystem::path& file) : state_(std::make_shared<State>()) {
  State& state = *state_;
  state.path = file.string();
  int code = 0;
  state.zip = zip_open(file.c_str(), ZIP_RDONLY | ZIP_CHECKCONS, &code);
  if (state.zip == nullptr) {
    zip_error_t error;
    zip_error_init_with_code(&error, code);
    const std::string why = zip_error_strerror(&error);
    zip_error_fini(&error);
    if (code == ZIP_ER_NOENT || code == ZIP_ER_OPEN) throw IoError(state.path, why);
    throw InputError(state.path + ": " + why);
  }
  const zip_int64_t count = zip_get_num_entries(state.zip, 0);
  for (zip_int64_t i = 0; i < count; ++i) {
    zip_stat_t status;
    const auto index = static_cast<zip_uint64_t>(i);
    if (zip_stat_index(state.zip, index, 0, &status) != 0 || (status.valid & ZIP_STAT_NAME) == 0 ||
        (status.valid & ZIP_STAT_SIZE) == 0) {
      throw InputError(state.path + ": entry " + std::to_string(i) + ": " + zip_strerror(state.zip));
    }
    const std::string name = status.name;
    if (name.empty() || name.back() == '/') continue;
    state.names.push_back(name);
    state.files.push_back({index, status.size});
  }
}

const std::vector<std::string>& ZipArchive::names() const {
  return state_->names;
}

std::uint64_t ZipArchive::size(std::size_t number) const {
  return state_->files.at(number).size;
}

std::string ZipArchive::read(std::size_t number) const {
  std::string contents;
  read(number, [&](std::string_view piece) {
    if (contents.size() + piece.size() > kLargestInMemory) {
      throw InputError(state_->path + ": " + state_->names[number] + ": more than 1 GiB");
    }
    contents.append(piece);
  });
  return contents;
}

void ZipArchive::read(std::size_t number, const std::function<void(std::string_view)>& piece) const {
  State& state = *state_;
  const std::lock_guard<std::mutex> lock(state.mutex);
  const std::string name = state.path + ": " + state.names.at(number);
  const std::unique_ptr<zip_file_t, int (*)(zip_file_t*)> file(
      zip_fopen_index(state.zip, state.files[number].index, 0), zip_fclose);
  if (!file) throw InputError(name + ": " + zip_strerror(state.zip));
  std::string buffer(1 << 16, '\0');
  zip_uint64_t done = 0;
  while (true) {
    const zip_int64_t got = zip_fread(file.get(), buffer.data(), buffer.size());
    if (got < 0) throw InputError(name + ": " + zip_file_strerror(file.get()));
    if (got == 0) break;
    done += static_cast<zip_uint64_t>(got);
    if (done > state.files[number].size) break;
    piece(std::string_view(buffer).substr(0, static_cast<std::size_t>(got)));
  }
  if (done != state.files[number].size) {
    throw InputError(name + ": " + std::to_string(done) + " bytes or more, the archive says " +
                     std::to_string(state.files[number].size));
  }
}

}  // namespace loopwise
