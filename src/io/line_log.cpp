// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/line_log.hpp>

#include <ios>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise {

LineLog::LineLog(std::filesystem::path path, Mode mode)
    : path_(std::move(path)),
      out_(path_, std::ios::binary | (mode == Mode::kAppend ? std::ios::app : std::ios::trunc)) {
  require_good();
}

void LineLog::add(const std::string& line) {
  out_ << line + "\n" << std::flush;
  require_good();
}

void LineLog::finish() {
  out_.close();
  require_good();
  flush_file(path_);
}

void LineLog::require_good() const {
  if (!out_) throw IoError(path_.string(), "cannot be written");
}

}  // namespace loopwise
