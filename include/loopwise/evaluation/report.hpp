// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A page that compares runs and opens in any browser without a network: map, charts, tables.
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

/// Bounds on the contents of a page.
struct ReportOptions {
  /// Maximum number of points of a map that are drawn.
  std::int64_t map_points = 20000;
  /// Maximum number of items of any other layer that are drawn, such as candidates of an outcome or links to
  /// a beacon.
  std::int64_t layer_items = 20000;
  /// Number of runs that are shown on a map, the first ones.
  std::int64_t maps = 8;
  /// Number of closures of a run whose scans the page shows, the most doubtful ones first. 0: no scans.
  std::int64_t review_closures = 60;
  /// Seed of the random choice in layers that have more items.
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("map_points", self.map_points, between(0, 5000000));
    field("layer_items", self.layer_items, between(1, 5000000));
    field("maps", self.maps, at_least(0));
    field("review_closures", self.review_closures, between(0, 100000));
    field("seed", self.seed, at_least(0));
  }
};

/// Contents of the folders.
struct Report {
  std::string data;                ///< JSON, the page's only input.
  std::size_t runs = 0;            ///< Runs that it shows.
  std::size_t studies = 0;         ///< Studies that it shows.
  std::size_t maps = 0;            ///< Runs with a map.
  std::vector<std::string> notes;  ///< Missing data and the reasons; the page shows them as well.
};

/// Reads folders of `loopwise replay` and of `loopwise study ablation`, `budget` or `rssi`, recognised by
/// their files, in the given order. A run needs only summary.json: other missing data are left out and noted.
/// The mission of a run's name adds true poses, beacons and radio, and the scans' observability. Scans are
/// read on `threads`; the result does not depend on their number.
///
/// With its mission a run has a review: closures, the most doubtful first, each with both scans, so that a
/// person can accept or reject it.
///
/// A run without truth is evaluated with that of its mission, and any run with one from set_truth(). Errors
/// of old runs of sessions become differences from a reference.
///
/// The data hold, per run, the other contents of summary.json, its history over mission time, and the scene:
/// nodes by robot with poses by the estimate, by odometry in truth and by a reference, points of the map,
/// candidates by outcome. A layer with more items than its bound is sampled uniformly without replacement,
/// and shows the total. Arrays are base64 of little-endian numbers, points quantised to 16 bits per axis of a
/// box without the outermost points.
///
/// \throws OptionError; InputError if a folder is of another kind, or a mission belongs to no run; IoError;
///         ParseError.
[[nodiscard]] LOOPWISE_EXPORT Report make_report(const std::vector<std::filesystem::path>& folders,
                                                 const std::vector<Mission>& missions,
                                                 const ReportOptions& options, ThreadPool& threads,
                                                 const ProgressCallback& progress = {});

/// Whether this build can write pages: they are bundled by npm, an optional part of the build.
[[nodiscard]] LOOPWISE_EXPORT bool report_pages_built();

/// The page around the data: HTML without external resources. The data are text that no browser interprets as
/// markup, for any names in it. \throws Error unless report_pages_built().
[[nodiscard]] LOOPWISE_EXPORT std::string report_page(std::string_view data);

/// make_report() and report_page() in one file. \throws like both; IoError
LOOPWISE_EXPORT Report write_report(const std::filesystem::path& file,
                                    const std::vector<std::filesystem::path>& folders,
                                    const std::vector<Mission>& missions, const ReportOptions& options,
                                    ThreadPool& threads, const ProgressCallback& progress = {});

}  // namespace loopwise
