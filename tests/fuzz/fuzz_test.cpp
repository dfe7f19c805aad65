// SPDX-License-Identifier: BSD-3-Clause
// Every fuzz target without a fuzzer: over its seeds, over alterations of them that are always the same, and
// over what fuzzing has found before.
#include <algorithm>

#include <loopwise/core/random.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "seeds.hpp"
#include "target.hpp"
#include "testing.hpp"

namespace loopwise::fuzz_test {
namespace {

namespace fs = std::filesystem;

const fuzz::Seeds& all_seeds() {
  static const fuzz::Seeds seeds = [] {
    fuzz::Seeds all = fuzz::io_seeds();
    all.merge(fuzz::replay_seeds());
    return all;
  }();
  return seeds;
}

/// The exception that left the target, or nothing.
std::string failure_of(const fuzz::Target& target, std::string_view bytes) {
  try {
    target.run(bytes);
    return {};
  } catch (const std::exception& error) {
    return error.what();
  }
}

/// Cuts, flips, repeats and numbers at the edge of their range.
std::string altered(std::string bytes, Rng& rng) {
  for (std::size_t n = 1 + rng.below(3); n > 0; --n) {
    const std::size_t at = rng.below(bytes.size() + 1),
                      length = rng.below(std::min<std::size_t>(bytes.size(), 64) + 1);
    const auto digit = static_cast<char>('0' + rng.below(10));
    switch (rng.below(7)) {
      case 0:
        bytes.resize(at);
        break;
      case 1:
        if (at < bytes.size()) bytes[at] = static_cast<char>(rng.below(256));
        break;
      case 2:
        bytes.erase(at, length);
        break;
      case 3:
        bytes.insert(at, bytes.substr(rng.below(bytes.size() + 1), length));
        break;
      case 4:
        bytes.insert(at, std::string(1, digit));
        break;
      case 5:
        for (std::size_t i = at; i < std::min(at + 4, bytes.size()); ++i) bytes[i] = '\xff';
        break;
      default:
        if (at < bytes.size()) bytes[at] = static_cast<char>(bytes[at] ^ (1 << rng.below(8)));
        break;
    }
  }
  return bytes;
}

TEST_CASE("fuzz: targets take their seeds, whole and altered", "[fuzz]") {
  constexpr int kAlterations = 60;  // of each seed
  REQUIRE(fuzz::targets().size() >= 23);
  for (const fuzz::Target& target : fuzz::targets()) {
    CAPTURE(target.name);
    REQUIRE(all_seeds().count(target.name) == 1);
    fuzz::attempts = {};
    for (const auto& [name, bytes] : all_seeds().at(target.name)) {
      CAPTURE(name);
      REQUIRE(failure_of(target, bytes) == "");
    }
    CAPTURE(fuzz::attempts.refused);
    REQUIRE((fuzz::attempts.accepted > 0 || fuzz::attempts.refused == 0));
    std::uint64_t number = 0;
    for (const auto& [name, bytes] : all_seeds().at(target.name)) {
      CAPTURE(name);
      for (int i = 0; i < kAlterations; ++i) {
        Rng rng(combine_seeds(++number, 1));
        const std::string other = altered(bytes, rng);
        const std::string failure = failure_of(target, other);
        if (!failure.empty()) {
          CAPTURE(i, failure);
          write_file(fs::temp_directory_path() / ("loopwise-finding-" + target.name), other);
          FAIL("see loopwise-finding-" << target.name << " in the folder of temporary files");
        }
      }
    }
  }
}

TEST_CASE("fuzz: past findings stay fixed", "[fuzz]") {
  std::size_t count = 0;
  for (const auto& folder : fs::directory_iterator(LOOPWISE_FUZZ_FINDINGS)) {
    const std::string name = folder.path().filename().string();
    CAPTURE(name);
    const auto target = std::find_if(fuzz::targets().begin(), fuzz::targets().end(),
                                     [&](const fuzz::Target& own) { return own.name == name; });
    if (target == fuzz::targets().end()) continue;  // a build without bags or MPI
    for (const auto& file : fs::directory_iterator(folder)) {
      CAPTURE(file.path().filename().string());
      CHECK(failure_of(*target, read_file(file.path())) == "");
      ++count;
    }
  }
  CHECK(count > 0);
}

}  // namespace
}  // namespace loopwise::fuzz_test
