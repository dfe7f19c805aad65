// SPDX-License-Identifier: BSD-3-Clause
// The page around a report's data.
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/report.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "report_template.hpp"

namespace loopwise {
namespace {

constexpr std::string_view kMark = "@LOOPWISE_DATA@";

}  // namespace

bool report_pages_built() {
  return !report_template().empty();
}

std::string report_page(std::string_view data) {
  const std::string_view page = report_template();
  if (page.empty()) {
    throw Error(
        "this build cannot write reports: its page is bundled by npm, which was absent or failed when this "
        "program was built. Install npm, configure with -DLOOPWISE_WITH_REPORT=ON and build again");
  }
  const std::size_t at = page.find(kMark);
  std::string out(page.substr(0, at));
  out.reserve(page.size() + data.size() + data.size() / 16);
  // In JSON '<' occurs only in strings. As an escape it cannot end an element or begin a comment.
  for (const char c : data) {
    if (c == '<') {
      out += "\\u003c";
    } else {
      out += c;
    }
  }
  out += page.substr(at + kMark.size());
  return out;
}

Report write_report(const std::filesystem::path& file, const std::vector<std::filesystem::path>& folders,
                    const std::vector<Mission>& missions, const ReportOptions& options, ThreadPool& threads,
                    const ProgressCallback& progress) {
  if (!report_pages_built()) static_cast<void>(report_page("{}"));  // throws before the work
  Report report = make_report(folders, missions, options, threads, progress);
  write_file(file, report_page(report.data));
  return report;
}

}  // namespace loopwise
