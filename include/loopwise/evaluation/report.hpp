// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Runs side by side as one page that opens in any browser, without a network: map, charts, tables.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise {

/// How much of its runs a page shows.
struct ReportOptions {
  std::int64_t map_points = 20000;
  std::int64_t layer_items = 20000;
  std::int64_t maps = 8;
  std::int64_t review_closures = 60;
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("map_points", self.map_points, between(0, 5000000), "Most points of a map that are drawn.");
    field("layer_items", self.layer_items, between(1, 5000000),
          "Most items of any other layer that are drawn: candidates of an outcome, links to a beacon.");
    field("maps", self.maps, at_least(0), "Runs that are shown on a map: the first ones.");
    field("review_closures", self.review_closures, between(0, 100000),
          "Closures of a run whose scans the page shows, the most doubtful ones first; 0: none.");
    field("seed", self.seed, at_least(0), "Of the draw where a layer has more.");
  }
};

/// What was found in the folders.
struct Report {
  std::string data;                ///< JSON, the page's only input.
  std::size_t runs = 0;            ///< Runs that it shows.
  std::size_t studies = 0;         ///< Studies that it shows.
  std::size_t maps = 0;            ///< Runs with a map.
  std::vector<std::string> notes;  ///< What could not be shown, and why; the page shows them as well.
};

/// Reads folders of `loopwise replay` and of `loopwise study ablation`, `budget` or `rssi`, told apart by
/// their files, in the order given. All but summary.json may be missing from a run: what it would show is
/// then left out and noted. A run takes from the mission of its name what its folder does not hold: true
/// poses, beacons and radio, the scans' observability. Scans are read on `threads`; the result does not
/// depend on their number.
///
/// With its mission a run has a review: closures, the most doubtful first, each with both scans, so that a
/// person can accept or reject it.
///
/// A run that knew no truth is judged by that of its mission, any run by one that set_truth() gave; what old
/// runs of sessions call errors becomes differences from a reference.
///
/// The data hold, per run, summary.json as it stands but for that, its history over mission time, and the
/// scene: nodes by robot with poses by the estimate, by odometry in truth and by a reference, points of the
/// map, candidates by outcome. A layer with more than its bound of items is drawn at random without
/// replacement, every item as likely; the total stands beside what is left. Arrays are base64 of
/// little-endian numbers, points quantised to 16 bits per axis of a box that holds all but the outermost.
///
/// \throws OptionError; InputError if a folder is neither, or a mission is none of the runs'; IoError;
///         ParseError.
[[nodiscard]] LOOPWISE_EXPORT Report make_report(const std::vector<std::filesystem::path>& folders,
                                                 const std::vector<Mission>& missions,
                                                 const ReportOptions& options, ThreadPool& threads,
                                                 const ProgressCallback& progress = {});

/// Whether this build can write pages: they are bundled by npm, an optional part of the build.
[[nodiscard]] LOOPWISE_EXPORT bool report_pages_built();

/// The page around the data: HTML that loads nothing from elsewhere. The data stand in it as text that no
/// browser takes for markup, whatever the names in it. \throws Error unless report_pages_built().
[[nodiscard]] LOOPWISE_EXPORT std::string report_page(std::string_view data);

/// make_report() and report_page() in one file. \throws as both; IoError
LOOPWISE_EXPORT Report write_report(const std::filesystem::path& file,
                                    const std::vector<std::filesystem::path>& folders,
                                    const std::vector<Mission>& missions, const ReportOptions& options,
                                    ThreadPool& threads, const ProgressCallback& progress = {});

}  // namespace loopwise
