// SPDX-License-Identifier: BSD-3-Clause
#include "raw_sequence.hpp"

#include <algorithm>
#include <cctype>
#include <map>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/key_frames.hpp>
#include <loopwise/io/trajectory.hpp>

#include "text.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kNsPerSecond = 1'000'000'000;
constexpr std::int64_t kKittiInterval_ns = 100'000'000;  // its lidar turns ten times a second

/// Converts a whole number of s, ms, µs or ns since 1970 to ns. Its digits show the unit (years 1973 to
/// 2286).
std::optional<std::int64_t> ns_of_digits(std::string_view digits) {
  std::int64_t value = 0;
  if (!text::has_only_digits(digits) || digits[0] == '0' || !text::parse_int64(digits, value))
    return std::nullopt;
  for (const auto& [least, unit_ns] :
       {std::pair<std::size_t, std::int64_t>{9, kNsPerSecond}, {12, 1'000'000}, {15, 1'000}, {18, 1}}) {
    if (digits.size() != least && digits.size() != least + 1) continue;
    if (value > 4'600'000'000'000'000'000 / unit_ns) return std::nullopt;
    return value * unit_ns;
  }
  return std::nullopt;
}

/// SECONDS and a whole number of NANOSECONDS.
std::optional<std::int64_t> ns_of_pair(std::string_view seconds, std::string_view nanoseconds) {
  std::int64_t s = 0, ns = 0;
  if (!text::has_only_digits(seconds) || seconds.size() > 10 || !text::has_only_digits(nanoseconds) ||
      nanoseconds.size() > 9 || !text::parse_int64(seconds, s) || !text::parse_int64(nanoseconds, ns))
    return std::nullopt;
  if (s > 4'600'000'000) return std::nullopt;
  return s * kNsPerSecond + ns;
}

Trajectory with_form(const fs::path& file, TrajectoryFormat form, Problems& problems) {
  Trajectory poses = form == TrajectoryFormat::kTum ? parse_stamped_poses(read_file(file), file.string())
                                                    : parse_trajectory(read_file(file), file.string(), form);
  problems.add(poses.problems);
  return poses;
}

/// Number of words in the first line that is not blank, a comment or a header of names.
std::size_t columns_in(const fs::path& file) {
  std::string contents = read_file(file);
  std::replace(contents.begin(), contents.end(), ',', ' ');
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    std::string_view word = text::next_word(line);
    double value = 0.0;
    if (word.empty() || text::parse_double(word, value) != text::Number::kOk) continue;
    std::size_t words = 0;
    for (; !word.empty(); word = text::next_word(line)) {
      if (text::parse_double(word, value) != text::Number::kOk) return 0;
      ++words;
    }
    return words;
  }
  return 0;
}

/// Sweeps of a folder, by a value in their names.
template <class Value>
std::vector<std::pair<Value, fs::path>> named_clouds(
    const fs::path& folder, const std::function<std::optional<Value>(const std::string&)>& value_of,
    Problems& problems) {
  std::map<Value, fs::path> named;
  for (const fs::path& file : entries(folder)) {
    if (!is_cloud_file(file) || !fs::is_regular_file(file)) continue;
    const auto value = value_of(cloud_stem(file));
    if (!value) {
      problems.add("foreign file in scans", file.string());
    } else if (!named.emplace(*value, file).second) {
      problems.add("repeated scan", file.string());
    }
  }
  return {named.begin(), named.end()};
}

/// A mission of one robot whose sweeps are files.
Mission mission_of(RobotStream stream, std::vector<fs::path> files, MissionKind kind, const fs::path& folder,
                   const MissionOptions& options, Problems problems) {
  stream.name = name_of(folder);
  const auto read = [files = std::move(files), layout = options.bin_layout](std::size_t, std::size_t sweep) {
    return read_cloud(files[sweep], layout);
  };
  Mission mission = make_key_frame_mission({std::move(stream)}, read, options);
  problems.add(mission.problems);
  mission.problems = std::move(problems);
  mission.kind = kind;
  mission.path = folder;
  mission.name = name_of(folder);
  mission.provenance_json = provenance_of(kind, {folder.filename().string()});
  return mission;
}

// KITTI

/// T_camera_lidar of calib.txt; nothing if the file or its line `Tr:` is missing.
std::optional<Eigen::Isometry3d> read_calibration(const fs::path& file, Problems& problems) {
  if (!fs::is_regular_file(file)) return std::nullopt;
  const std::string name = file.string(), contents = read_file(file);
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view tag = text::next_word(line);
    if (tag != "Tr:" && tag != "Tr" && tag != "Tr_velo_to_cam:" && tag != "Tr_velo_cam:") continue;
    const text::Place place{name, lines.number()};
    double values[12];
    const std::size_t found = text::read_numbers(line, values, 12, place);
    if (found != 12) place.fail("Tr needs 12 values, found " + std::to_string(found));
    const text::Rigid rigid = text::rigid_of(values, place);
    if (!rigid.was_rotation) problems.add_altered("rotation not orthonormal", place.str());
    return rigid.pose;
  }
  return std::nullopt;
}

std::vector<std::int64_t> read_times(const fs::path& file) {
  std::vector<std::int64_t> stamps;
  if (!fs::is_regular_file(file)) return stamps;
  const std::string name = file.string(), contents = read_file(file);
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    const std::string_view word = text::next_word(line);
    if (word.empty()) continue;
    const auto stamp = text::parse_seconds_ns(word);
    if (!stamp || !stamp_in_range(*stamp))
      text::Place{name, lines.number()}.fail(text::quoted(word) + " is not a stamp in seconds");
    stamps.push_back(*stamp);
  }
  return stamps;
}

/// Converts poses of the camera to poses of the lidar, and their world frame likewise.
void to_lidar(const Eigen::Isometry3d& T_camera_lidar, std::vector<StampedPose>& poses) {
  for (StampedPose& pose : poses)
    pose.pose = se3::normalized(T_camera_lidar.inverse() * pose.pose * T_camera_lidar);
}

/// Poses with stamps. Poses of TUM have their own, and rows have those of times.txt.
std::vector<StampedPose> stamped(const Trajectory& poses, const std::vector<std::int64_t>& times,
                                 const std::string& file, Problems& problems) {
  std::vector<StampedPose> out;
  for (std::size_t i = 0; i < poses.poses.size(); ++i) {
    if (poses.format == TrajectoryFormat::kTum) {
      out.push_back({poses.stamps_ns[i], poses.poses[i]});
    } else if (i < times.size()) {
      out.push_back({times[i], poses.poses[i]});
    } else {
      problems.add_altered("row beyond the common part left out",
                           file + ": row " + std::to_string(i) + ", for which times.txt has no line");
    }
  }
  return out;
}

/// Counts poses that seem to be of another sensor: a lidar on a car moves along its x axis.
void check_forward(const std::vector<StampedPose>& poses, bool calibrated, const std::string& file,
                   Problems& problems) {
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  for (std::size_t i = 1; i < poses.size(); ++i)
    moved += (poses[i - 1].pose.inverse() * poses[i].pose).translation().cwiseAbs();
  Eigen::Index axis = 0;
  if (moved.maxCoeff(&axis) < 1.0 || axis == 0) return;
  problems.add("lidar does not move along its x axis",
               file + ": it moves along " + "xyz"[axis] + ": " +
                   (calibrated ? "if the poses are those of the lidar, not of the camera, remove calib.txt"
                               : "if the poses are those of the camera, add calib.txt with Tr"));
}

struct KittiPoses {
  fs::path odometry;
  fs::path truth;  ///< Empty if the only poses are the odometry.
};
KittiPoses kitti_poses(const fs::path& folder, const MissionOptions& options) {
  const fs::path whole = fs::absolute(folder / "").lexically_normal().parent_path();
  const fs::path shared = whole.parent_path().parent_path() / "poses" / (whole.filename().string() + ".txt");
  const fs::path own = fs::is_regular_file(folder / "poses.txt") ? folder / "poses.txt"
                       : fs::is_regular_file(shared)             ? shared
                                                                 : fs::path();
  if (!options.poses.empty()) return {options.poses, own};
  if (own.empty()) {
    throw InputError(folder.string() + ": no poses: neither poses.txt in it nor " + shared.string() +
                     "; --poses FILE gives those of an odometry");
  }
  return {own, {}};
}

/// Reads the poses of a file as poses of the lidar.
std::vector<StampedPose> lidar_poses(const fs::path& file, const std::vector<std::int64_t>& times,
                                     const std::optional<Eigen::Isometry3d>& T_camera_lidar,
                                     Problems& problems) {
  const std::size_t columns = columns_in(file);
  const bool is_rows = columns == 12;
  std::vector<StampedPose> poses =
      stamped(with_form(file, is_rows ? TrajectoryFormat::kKitti : TrajectoryFormat::kTum, problems), times,
              file.string(), problems);
  if (T_camera_lidar) to_lidar(*T_camera_lidar, poses);
  check_forward(poses, T_camera_lidar.has_value(), file.string(), problems);
  return poses;
}

/// Sets the true poses of the nodes by stamp: nodes have the stamps of sweeps, and so do the rows.
void set_truth_of_rows(Mission& mission, const std::vector<StampedPose>& truth, const fs::path& file) {
  std::map<std::int64_t, Eigen::Isometry3d> by_stamp;
  for (const StampedPose& pose : truth) by_stamp.emplace(pose.stamp_ns, pose.pose);
  std::map<Key, Eigen::Isometry3d> poses;
  for (const Node& node : mission.graph.nodes()) {
    const auto found = by_stamp.find(node.stamp_ns);
    if (found != by_stamp.end()) poses.emplace(node.key, found->second);
  }
  set_ground_truth(mission, std::move(poses));
  mission.problems.add("poses of the data set used as the truth", file.string());
}

}  // namespace

bool is_kitti_sequence(const fs::path& folder) {
  if (!fs::is_directory(folder / "velodyne")) return false;
  const std::vector<fs::path> files = entries(folder / "velodyne");
  return std::any_of(files.begin(), files.end(), [](const fs::path& file) { return is_cloud_file(file); });
}

Mission read_kitti_sequence(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  const KittiPoses files = kitti_poses(folder, options);
  const auto T_camera_lidar = read_calibration(folder / "calib.txt", problems);
  if (!T_camera_lidar) {
    problems.add("no calibration given", (folder / "calib.txt").string() +
                                             ": no line Tr: the poses are assumed to be those of the lidar");
  }
  const auto sweeps = named_clouds<std::uint64_t>(
      folder / "velodyne",
      [](const std::string& stem) -> std::optional<std::uint64_t> {
        std::uint64_t row = 0;
        if (!text::has_only_digits(stem) || text::parse_id(stem, row) != nullptr || row > 1'000'000'000)
          return std::nullopt;
        return row;
      },
      problems);
  std::vector<std::int64_t> times = read_times(folder / "times.txt");
  if (times.empty()) {
    problems.add("no stamps given",
                 (folder / "times.txt").string() + ": sweeps are assumed to be 0.1 s apart");
    const std::uint64_t rows = sweeps.empty() ? 0 : sweeps.back().first + 1;
    for (std::uint64_t i = 0; i < rows; ++i)
      times.push_back(static_cast<std::int64_t>(i) * kKittiInterval_ns);
  }
  RobotStream stream;
  stream.source = folder.string();
  stream.odometry = lidar_poses(files.odometry, times, T_camera_lidar, problems);
  std::vector<fs::path> clouds;
  for (const auto& [row, file] : sweeps) {
    if (row >= times.size()) {
      problems.add_altered("row beyond the common part left out",
                           file.string() + ": times.txt has " + std::to_string(times.size()) + " rows");
      continue;
    }
    stream.sweep_stamps_ns.push_back(times[row]);
    clouds.push_back(file);
  }
  std::vector<StampedPose> truth;
  if (files.truth.empty()) {
    problems.add("odometry taken from the poses of the data set",
                 files.odometry.string() +
                     ": perhaps the truth, without drift: --poses gives an odometry, --odometry-noise adds "
                     "noise");
  } else {
    truth = lidar_poses(files.truth, times, T_camera_lidar, problems);
  }
  Mission mission = mission_of(std::move(stream), std::move(clouds), MissionKind::kKitti, folder, options,
                               std::move(problems));
  if (!truth.empty()) set_truth_of_rows(mission, truth, files.truth);
  return mission;
}

std::optional<std::int64_t> stamp_of_name(std::string_view stem) {
  while (!stem.empty() && std::isdigit(static_cast<unsigned char>(stem.front())) == 0) stem.remove_prefix(1);
  if (const auto ns = ns_of_digits(stem)) return ns;
  const std::size_t at = stem.find_first_of("._-");
  if (at == std::string_view::npos || at < 9) return std::nullopt;
  const std::string_view seconds = stem.substr(0, at), rest = stem.substr(at + 1);
  if (!text::has_only_digits(seconds) || !text::has_only_digits(rest)) return std::nullopt;
  if (stem[at] != '.') return ns_of_pair(seconds, rest);
  return seconds.size() <= 10 ? text::parse_seconds_ns(stem) : std::nullopt;
}

fs::path stamped_clouds_of(const fs::path& folder) {
  const auto has_stamps = [](const fs::path& place) {
    const std::vector<fs::path> files = entries(place);
    const auto first =
        std::find_if(files.begin(), files.end(), [](const fs::path& file) { return is_cloud_file(file); });
    return first != files.end() && stamp_of_name(cloud_stem(*first)).has_value();
  };
  if (has_stamps(folder)) return folder;
  fs::path found;
  const auto may_be_read = [](const fs::path& place) {
    std::error_code error;
    const fs::directory_iterator first(place, error);
    return !error;
  };
  for (const fs::path& entry : entries(folder)) {
    std::error_code unknown;
    if (!fs::is_directory(entry, unknown) || is_truth(entry) || !may_be_read(entry) || !has_stamps(entry))
      continue;
    if (!found.empty()) {
      throw InputError(folder.string() + ": clouds in " + found.filename().string() + "/ and " +
                       entry.filename().string() +
                       "/ are named by stamps: give one of the folders, with --poses FILE");
    }
    found = entry;
  }
  return found;
}

Trajectory parse_stamped_poses(const std::string& contents, const std::string& name) {
  std::string plain;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) {
    std::string words(line);
    std::replace(words.begin(), words.end(), ',', ' ');
    std::string_view rest = words;
    const std::string_view first = text::next_word(rest);
    double number = 0.0;
    const bool names = text::parse_double(first, number) == text::Number::kNotANumber && lines.number() == 1;
    if (names) words.clear();
    std::string_view look = rest;
    const std::string_view second = text::next_word(look);
    std::size_t count = first.empty() ? 0 : 1;
    for (std::string_view after = rest; !text::next_word(after).empty();) ++count;
    const auto pair = count == 9 ? ns_of_pair(first, second) : std::nullopt;
    const auto whole = pair ? pair : first.size() >= 12 ? ns_of_digits(first) : std::nullopt;
    if (!names && whole) {
      std::string fraction = std::to_string(*whole % kNsPerSecond);
      fraction.insert(0, 9 - fraction.size(), '0');
      plain += std::to_string(*whole / kNsPerSecond) + "." + fraction + std::string(pair ? look : rest);
    } else {
      plain += words;
    }
    if (lines.ended()) plain += '\n';
  }
  return parse_trajectory(plain, name, TrajectoryFormat::kTum);
}

namespace {

/// The file with the poses for clouds that are named by stamps.
fs::path poses_of_clouds(const fs::path& folder, const fs::path& clouds, const MissionOptions& options) {
  if (!options.poses.empty()) return options.poses;
  std::vector<fs::path> found;
  std::vector<fs::path> places{folder};
  if (clouds != folder) places.push_back(clouds);
  for (const fs::path& place : places) {
    for (const fs::path& file : entries(place)) {
      const fs::path ending = file.extension();
      if (!fs::is_regular_file(file) || (ending != ".txt" && ending != ".tum" && ending != ".csv")) continue;
      const std::size_t columns = columns_in(file);
      if (columns == 8 || columns == 9) found.push_back(file);
    }
  }
  if (found.size() == 1) return found.front();
  if (found.empty()) {
    throw InputError(folder.string() +
                     ": clouds named by stamps, but no poses: no .txt, .tum or .csv file with lines of 8 "
                     "numbers (TUM: stamp x y z qx qy qz qw); --poses FILE gives it");
  }
  throw InputError(folder.string() + ": " + found[0].filename().string() + " and " +
                   found[1].filename().string() + " may both be its poses: --poses FILE selects one");
}

}  // namespace

Mission read_stamped_clouds(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  const fs::path place = stamped_clouds_of(folder);
  const fs::path file = poses_of_clouds(folder, place, options);
  if (columns_in(file) == 12) {
    throw InputError(
        file.string() +
        ": KITTI rows have no stamps, and the clouds are named by stamps: poses in TUM format are "
        "needed (stamp x y z qx qy qz qw)");
  }
  const Trajectory poses = with_form(file, TrajectoryFormat::kTum, problems);
  RobotStream stream;
  stream.source = folder.string();
  stream.odometry = stamped(poses, {}, file.string(), problems);
  std::vector<fs::path> clouds;
  for (auto& [stamp, cloud] : named_clouds<std::int64_t>(
           place, [](const std::string& stem) { return stamp_of_name(stem); }, problems)) {
    stream.sweep_stamps_ns.push_back(stamp);
    clouds.push_back(cloud);
  }
  return mission_of(std::move(stream), std::move(clouds), MissionKind::kStampedClouds, folder, options,
                    std::move(problems));
}

}  // namespace loopwise::parts
