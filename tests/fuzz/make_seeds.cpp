// SPDX-License-Identifier: BSD-3-Clause
// make_seeds FOLDER: writes FOLDER/TARGET/NAME for every seed.
#include <iostream>

#include "seeds.hpp"
#include "target.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "Usage: " << argv[0] << " FOLDER\n";
    return 2;
  }
  std::size_t count = 0;
  loopwise::fuzz::Seeds all = loopwise::fuzz::io_seeds();
  all.merge(loopwise::fuzz::replay_seeds());
  for (const auto& [target, list] : all) {
    const std::filesystem::path folder = std::filesystem::path(argv[1]) / target;
    std::filesystem::create_directories(folder);
    for (const auto& [name, bytes] : list) {
      loopwise::fuzz::put_file(folder / name, bytes);
      ++count;
    }
  }
  std::cout << count << " seeds\n";
}
