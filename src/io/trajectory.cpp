// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/trajectory.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <numeric>
#include <queue>
#include <string_view>
#include <tuple>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/g2o.hpp>

#include "file_kind.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

constexpr const char* kWantedTrajectory = "a trajectory in TUM or KITTI format or a g2o graph";
constexpr std::initializer_list<FileKind> kTrajectories = {FileKind::kTum, FileKind::kKitti, FileKind::kG2o,
                                                           FileKind::kEmpty};
constexpr std::size_t kTumNumbers = 8;
constexpr std::size_t kTumWithId = 9;  // RTAB-Map writes the id of the node after the pose
constexpr std::size_t kKittiNumbers = 12;

/// Format of the first line that is neither blank nor a comment.
TrajectoryFormat recognise(const std::string& file, std::string_view contents) {
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    std::string_view first = text::next_word(line);
    if (first.empty()) continue;
    const char c = first[0];
    if ((c >= 'A' && c <= 'Z') || c == '_') return TrajectoryFormat::kG2o;
    std::size_t words = 1;
    while (!text::next_word(line).empty()) ++words;
    if (words == kTumNumbers || words == kTumWithId) return TrajectoryFormat::kTum;
    if (words == kKittiNumbers) return TrajectoryFormat::kKitti;
    throw ParseError(file, lines.number(),
                     std::to_string(words) +
                         " values, expected 8 (TUM: stamp x y z qx qy qz qw), 12 (KITTI: rows "
                         "of a 3x4 matrix) or a g2o tag");
  }
  throw InputError(file + ": has no poses");
}

void read_tum_line(std::string_view line, const text::Place& place, Trajectory& out) {
  std::string_view rest = line;
  const std::string_view stamp = text::next_word(rest);
  double values[kTumWithId - 1];
  const std::size_t found = text::read_numbers(rest, values, kTumWithId - 1, place) + 1;
  const bool has_id = found == kTumWithId && values[kTumNumbers - 1] == std::floor(values[kTumNumbers - 1]);
  if (found != kTumNumbers && !has_id)
    place.fail("a TUM pose needs 8 values, found " + std::to_string(found));
  const auto ns = text::parse_seconds_ns(stamp);
  if (!ns) place.fail(text::quoted(stamp) + " is not a stamp in seconds");
  const text::Pose pose = text::pose_of(values, place);
  if (!pose.was_unit) out.problems.add_altered("non-unit quaternion", place.str());
  out.stamps_ns.push_back(*ns);
  out.poses.push_back(pose.pose);
}

void read_kitti_line(std::string_view line, const text::Place& place, Trajectory& out) {
  double values[kKittiNumbers];
  const std::size_t found = text::read_numbers(line, values, kKittiNumbers, place);
  if (found != kKittiNumbers) place.fail("a KITTI pose needs 12 values, found " + std::to_string(found));
  const text::Rigid rigid = text::rigid_of(values, place);
  if (!rigid.was_rotation) out.problems.add_altered("rotation not orthonormal", place.str());
  out.poses.push_back(rigid.pose);
}

std::string seconds_text(std::int64_t stamp_ns) {
  constexpr std::uint64_t kSecond = 1'000'000'000;
  const auto bits = static_cast<std::uint64_t>(stamp_ns);
  const std::uint64_t ns = stamp_ns < 0 ? std::uint64_t{0} - bits : bits;
  const std::string fraction = std::to_string(ns % kSecond);
  return (stamp_ns < 0 ? "-" : "") + std::to_string(ns / kSecond) + '.' +
         std::string(9 - fraction.size(), '0') + fraction;
}

std::vector<std::size_t> by_stamp(const std::vector<std::int64_t>& stamps) {
  std::vector<std::size_t> order(stamps.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return stamps[a] < stamps[b]; });
  return order;
}

/// Sorts poses by their stamps and counts problems of the stamps. `lines` has the line of each pose.
void sort_by_stamp(const std::string& file, const std::vector<std::size_t>& lines, Trajectory& out) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const std::vector<std::int64_t> read = out.stamps_ns;
  const auto place = [&](std::size_t i) {
    return text::Place{file, lines[i]}.str() + ": " + seconds_text(read[i]);
  };
  for (std::size_t i = 1; i < read.size(); ++i) {
    if (read[i] < read[i - 1])
      out.problems.add("pose with a stamp before the preceding one, sorted", place(i));
  }
  const std::vector<std::size_t> order = by_stamp(read);
  const std::vector<Eigen::Isometry3d> poses = out.poses;
  for (std::size_t i = 0; i < order.size(); ++i) {
    out.poses[i] = poses[order[i]];
    out.stamps_ns[i] = read[order[i]];
    if (i > 0 && out.stamps_ns[i] == out.stamps_ns[i - 1])
      out.problems.add("repeated stamp, perhaps written with too few digits", place(order[i]));
  }
  const bool sorted = std::is_sorted(read.begin(), read.end());
  if (!sorted && out.stamps_ns.front() >= 0 && out.stamps_ns.back() < kSecond) {
    out.problems.add("stamps that may lack their seconds",
                     file + ": all are between 0 and 1 s and not ascending");
  }
}

Trajectory read_lines(const std::string& file, std::string_view contents, TrajectoryFormat format) {
  Trajectory out;
  out.format = format;
  text::Lines lines(contents);
  std::vector<std::size_t> numbers;
  for (std::string_view line; lines.next(line);) {
    std::string_view look = line;
    if (text::next_word(look).empty()) continue;
    const text::Place place{file, lines.number()};
    numbers.push_back(lines.number());
    if (format == TrajectoryFormat::kTum) {
      read_tum_line(line, place, out);
    } else {
      read_kitti_line(line, place, out);
    }
  }
  if (out.poses.empty()) throw InputError(file + ": has no poses");
  if (!lines.ended()) out.problems.add("no line end after the last line", file);
  if (format == TrajectoryFormat::kTum) sort_by_stamp(file, numbers, out);
  out.keys.resize(out.poses.size());
  std::iota(out.keys.begin(), out.keys.end(), Key{0});
  return out;
}

Trajectory read_vertices(const std::string& name, std::string_view contents) {
  G2oFile file = parse_g2o(contents, name);
  Trajectory out;
  out.format = TrajectoryFormat::kG2o;
  out.poses = file.graph.poses();
  out.keys = file.graph.keys();
  out.problems = std::move(file.problems);
  return out;
}

using IndexPairs = std::vector<std::pair<std::size_t, std::size_t>>;

IndexPairs pair_by_key(const Trajectory& estimate, const Trajectory& truth) {
  std::map<Key, std::size_t> rows;
  for (std::size_t i = 0; i < truth.keys.size(); ++i) rows.emplace(truth.keys[i], i);
  IndexPairs pairs;
  for (std::size_t i = 0; i < estimate.keys.size(); ++i) {
    if (const auto found = rows.find(estimate.keys[i]); found != rows.end())
      pairs.emplace_back(i, found->second);
  }
  return pairs;
}

/// A pose of either trajectory on their common time line.
struct Moment {
  std::int64_t stamp;
  std::size_t rank;  ///< Among poses of equal stamp in its trajectory, which are paired in order.
  bool of_truth;
  std::size_t row;
};

std::vector<Moment> time_line(const Trajectory& estimate, const Trajectory& truth) {
  std::vector<Moment> line;
  for (const bool of_truth : {false, true}) {
    const std::vector<std::int64_t>& stamps = of_truth ? truth.stamps_ns : estimate.stamps_ns;
    const std::vector<std::size_t> order = by_stamp(stamps);
    for (std::size_t i = 0, rank = 0; i < order.size(); ++i) {
      const std::int64_t stamp = stamps[order[i]];
      rank = i > 0 && stamp == stamps[order[i - 1]] ? rank + 1 : 0;
      line.push_back({stamp, rank, of_truth, order[i]});
    }
  }
  std::sort(line.begin(), line.end(), [](const Moment& a, const Moment& b) {
    return std::tie(a.stamp, a.rank, a.of_truth) < std::tie(b.stamp, b.rank, b.of_truth);
  });
  return line;
}

/// Pairs poses within the tolerance, closest first; each pose is used once. The closest remaining poses are
/// always adjacent on the time line, so not all pairs within the tolerance have to be listed.
IndexPairs pair_by_stamp(const Trajectory& estimate, const Trajectory& truth, double tolerance_s) {
  struct Choice {
    std::uint64_t gap_ns;
    std::size_t estimate, truth;  // rows
    std::size_t left, right;      // moments
    bool operator>(const Choice& other) const {
      return std::tie(gap_ns, estimate, truth) > std::tie(other.gap_ns, other.estimate, other.truth);
    }
  };
  const auto tolerance_ns = static_cast<std::uint64_t>(std::llround(std::clamp(tolerance_s, 0.0, 1e9) * 1e9));
  const std::vector<Moment> line = time_line(estimate, truth);
  std::vector<std::size_t> before(line.size()), after(line.size());
  std::vector<char> used(line.size());
  std::priority_queue<Choice, std::vector<Choice>, std::greater<>> choices;
  const auto consider = [&](std::size_t left, std::size_t right) {
    const Moment &a = line[left], &b = line[right];
    // Unsigned, because the difference of two stamps may exceed the signed range.
    const std::uint64_t gap = static_cast<std::uint64_t>(b.stamp) - static_cast<std::uint64_t>(a.stamp);
    if (a.of_truth == b.of_truth || gap > tolerance_ns) return;
    choices.push({gap, a.of_truth ? b.row : a.row, a.of_truth ? a.row : b.row, left, right});
  };
  for (std::size_t i = 0; i < line.size(); ++i) {
    before[i] = i - 1;  // for the first, the value wraps beyond the end
    after[i] = i + 1;
    if (i > 0) consider(i - 1, i);
  }
  IndexPairs pairs;
  while (!choices.empty()) {
    const Choice choice = choices.top();
    choices.pop();
    if (used[choice.left] || used[choice.right]) continue;
    used[choice.left] = used[choice.right] = 1;
    pairs.emplace_back(choice.estimate, choice.truth);
    const std::size_t left = before[choice.left], right = after[choice.right];
    if (left < line.size()) after[left] = right;
    if (right < line.size()) before[right] = left;
    if (left < line.size() && right < line.size()) consider(left, right);
  }
  std::sort(pairs.begin(), pairs.end());
  return pairs;
}

std::string span(const Trajectory& trajectory) {
  const auto [first, last] = std::minmax_element(trajectory.stamps_ns.begin(), trajectory.stamps_ns.end());
  return seconds_text(*first) + " to " + seconds_text(*last) + " s";
}

/// Name of a pose in messages.
std::string pose_name(const Trajectory& trajectory, std::size_t i, bool by_stamp) {
  return by_stamp ? "stamp " + seconds_text(trajectory.stamps_ns[i]) : key_name(trajectory.keys[i]);
}

/// Whether every key of the g2o file is a row of the other file.
bool keys_are_rows(const Trajectory& g2o, const Trajectory& rows) {
  return std::all_of(g2o.keys.begin(), g2o.keys.end(), [&](Key key) { return key < rows.poses.size(); });
}

}  // namespace

Trajectory parse_trajectory(std::string_view text, const std::string& source) {
  refuse_foreign(text, source, kTrajectories, kWantedTrajectory);
  return parse_trajectory(text, source, recognise(source, text));
}

Trajectory parse_trajectory(std::string_view text, const std::string& source, TrajectoryFormat format) {
  refuse_foreign(text, source, kTrajectories, kWantedTrajectory);
  return format == TrajectoryFormat::kG2o ? read_vertices(source, text) : read_lines(source, text, format);
}

Trajectory read_trajectory(const std::filesystem::path& path) {
  refuse_foreign_file(path, kTrajectories, kWantedTrajectory);
  return parse_trajectory(read_file(path), path.string());
}

Trajectory read_trajectory(const std::filesystem::path& path, TrajectoryFormat format) {
  return parse_trajectory(read_file(path), path.string(), format);
}

std::vector<StampedPose> read_tum(const std::filesystem::path& path) {
  const Trajectory trajectory = read_trajectory(path, TrajectoryFormat::kTum);
  std::vector<StampedPose> poses;
  for (std::size_t i = 0; i < trajectory.poses.size(); ++i) {
    poses.push_back({trajectory.stamps_ns[i], trajectory.poses[i]});
  }
  return poses;
}

std::vector<Eigen::Isometry3d> read_kitti(const std::filesystem::path& path) {
  return read_trajectory(path, TrajectoryFormat::kKitti).poses;
}

void write_tum(const std::filesystem::path& path, const std::vector<StampedPose>& poses) {
  std::string out;
  for (const StampedPose& stamped : poses) {
    out += seconds_text(stamped.stamp_ns) + ' ';
    text::append_pose(out, stamped.pose);
    out += '\n';
  }
  write_file(path, out);
}

void write_kitti(const std::filesystem::path& path, const std::vector<Eigen::Isometry3d>& poses) {
  std::string out;
  for (const Eigen::Isometry3d& pose : poses) {
    for (int i = 0; i < 12; ++i) {
      text::append(out, pose(i / 4, i % 4));
      out += i < 11 ? ' ' : '\n';
    }
  }
  write_file(path, out);
}

PosePairs associate(const Trajectory& estimate, const Trajectory& truth, double max_time_difference_s) {
  const bool estimate_keys = estimate.format == TrajectoryFormat::kG2o;
  const bool truth_keys = truth.format == TrajectoryFormat::kG2o;
  const bool both_stamped = !estimate.stamps_ns.empty() && !truth.stamps_ns.empty();
  const auto rows_are_keys = [&] {
    return (estimate_keys && keys_are_rows(estimate, truth)) ||
           (truth_keys && keys_are_rows(truth, estimate));
  };
  IndexPairs pairs;
  const bool by_key = (estimate_keys && truth_keys) || (!both_stamped && rows_are_keys());
  const bool by_stamp = !by_key && both_stamped;
  if (by_key) {
    pairs = pair_by_key(estimate, truth);
  } else if (by_stamp) {
    pairs = pair_by_stamp(estimate, truth, max_time_difference_s);
  } else if (estimate.poses.size() == truth.poses.size()) {
    for (std::size_t i = 0; i < estimate.poses.size(); ++i) pairs.emplace_back(i, i);
  } else {
    throw InputError("cannot pair " + std::to_string(estimate.poses.size()) + " poses (" +
                     enum_name(estimate.format) + ") with " + std::to_string(truth.poses.size()) + " (" +
                     enum_name(truth.format) +
                     "): without common keys or stamps their numbers must be equal");
  }
  if (pairs.empty()) {
    throw InputError("no pose of the estimate has a match in the truth: " +
                     (by_stamp ? "no stamps close enough, those of the estimate are " + span(estimate) +
                                     ", of the truth " + span(truth)
                               : std::string("no common key")));
  }

  PosePairs out;
  std::vector<char> has_truth(estimate.poses.size()), has_estimate(truth.poses.size());
  for (const auto& [e, t] : pairs) {
    out.keys.push_back(estimate.keys[e]);
    out.estimate.push_back(estimate.poses[e]);
    out.truth.push_back(truth.poses[t]);
    has_truth[e] = has_estimate[t] = 1;
  }
  for (std::size_t i = 0; i < has_truth.size(); ++i) {
    if (!has_truth[i]) out.problems.add("pose without truth", pose_name(estimate, i, by_stamp));
  }
  for (std::size_t i = 0; i < has_estimate.size(); ++i) {
    if (!has_estimate[i]) out.problems.add("truth without pose", pose_name(truth, i, by_stamp));
  }
  return out;
}

Eigen::Isometry3d read_transform(const std::filesystem::path& path) {
  return parse_transform(read_file(path), path.string());
}

Eigen::Isometry3d parse_transform(std::string_view text, const std::string& file) {
  refuse_foreign(text, file, {FileKind::kTum, FileKind::kKitti, FileKind::kEmpty},
                 "a transform of 7, 12 or 16 numbers");
  double values[16];
  std::size_t count = 0;
  text::Lines lines(text);
  for (std::string_view line; lines.next(line);) {
    double row[16];
    const std::size_t found = text::read_numbers(line, row, 16, {file, lines.number()});
    if (count + found > 16)
      throw ParseError(file, lines.number(), "more than 16 numbers, expected one transform");
    std::copy(row, row + found, values + count);
    count += found;
  }
  const text::Place last{file, std::max<std::size_t>(1, lines.number())};
  if (count == 7) return text::pose_of(values, last).pose;
  if (count != 12 && count != 16) {
    last.fail(std::to_string(count) + " numbers, expected 12 or 16 of a matrix or 7 (x y z qx qy qz qw)");
  }
  if (count == 16 && (std::abs(values[12]) > 1e-9 || std::abs(values[13]) > 1e-9 ||
                      std::abs(values[14]) > 1e-9 || std::abs(values[15] - 1.0) > 1e-9)) {
    last.fail("the last row of a 4x4 transform must be 0 0 0 1");
  }
  return text::rigid_of(values, last).pose;
}

}  // namespace loopwise
