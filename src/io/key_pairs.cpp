// SPDX-License-Identifier: BSD-3-Clause
#include "key_pairs.hpp"

#include <algorithm>
#include <new>
#include <sstream>

#include <loopwise/core/error.hpp>

namespace loopwise::parts {

KeyPairs parse_key_pairs(const std::string& contents, const std::string& name) {
  std::istringstream lines(contents);
  KeyPairs pairs;
  std::string line;
  for (std::size_t number = 1; std::getline(lines, line); ++number) {
    line.resize(std::min(line.find('#'), line.size()));
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    std::string from, to, more;
    if (!(words >> from)) {
      if (words.bad()) throw std::bad_alloc();  // streams hide allocation failures
      continue;
    }
    if (!(words >> to) || (words >> more)) {
      if (words.bad()) throw std::bad_alloc();
      throw ParseError(name, number, "expected two keys");
    }
    if (words.bad()) throw std::bad_alloc();
    try {
      pairs.emplace(parse_key(from), parse_key(to));
    } catch (const InputError& error) {
      throw ParseError(name, number, error.what());
    }
  }
  if (lines.bad()) throw std::bad_alloc();
  return pairs;
}

}  // namespace loopwise::parts
