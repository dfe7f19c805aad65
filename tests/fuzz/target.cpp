// SPDX-License-Identifier: BSD-3-Clause
#include "target.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>

namespace loopwise::fuzz {
namespace {

namespace fs = std::filesystem;

std::vector<Target>& list() {
  static std::vector<Target> targets;
  return targets;
}

struct Folder {
  Folder() {
    const char* const given = std::getenv("LOOPWISE_FUZZ_SCRATCH");
    const fs::path memory = "/dev/shm";
    const fs::path parent = given != nullptr           ? fs::path(given)
                            : fs::is_directory(memory) ? memory
                                                       : fs::temp_directory_path();
    std::string pattern = (parent / "loopwise-fuzz-XXXXXX").string();
    if (::mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("cannot make a folder " + pattern);
    path = pattern;
  }
  ~Folder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  fs::path path;
};

}  // namespace

Registered::Registered(const char* name, Function run) {
  const auto after =
      std::find_if(list().begin(), list().end(), [&](const Target& target) { return target.name > name; });
  list().insert(after, {name, run});
}

const std::vector<Target>& targets() {
  return list();
}

std::size_t take_choice(std::string_view& bytes, std::size_t count) {
  if (bytes.empty()) return 0;
  const auto first = static_cast<unsigned char>(bytes.front());
  bytes.remove_prefix(1);
  return first % count;
}

const fs::path& scratch() {
  static const Folder folder;
  return folder.path;
}

void put_file(const fs::path& path, std::string_view bytes) {
  std::ofstream out(path, std::ios::binary);
  out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!out.flush()) throw std::runtime_error("cannot write " + path.string());
}

}  // namespace loopwise::fuzz
