// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/key_frames.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "mission_parts.hpp"

namespace loopwise {
namespace {

constexpr std::size_t kStreamLetters = 26;
constexpr double kLeastGap_s = 1.0;     // robots that send only key poses have steps of about a second
constexpr double kUsualGaps = 10.0;     // times the usual interval
constexpr double kLongestStep_s = 1.0;  // poses are not interpolated over longer steps
constexpr double kSameTime_s = 0.001;
constexpr double kNever_s = 1e12;
constexpr double kLeastJump_m = 1.0;  // with stamps in milliseconds, short steps seem fast
constexpr double kLargestSpeed_mps = 50.0;
constexpr double kAtOrigin_m = 0.5;
constexpr float kFarthest_m = 1e7f;  // as read_cloud()

double seconds(std::int64_t from, std::int64_t to) {
  return static_cast<double>(to - from) * 1e-9;
}

std::string at(const std::string& source, std::int64_t stamp_ns) {
  return source + ": at " + std::to_string(seconds(0, stamp_ns)) + " s";
}

/// A sweep at a stamp, with its pose when that is known.
struct Sweep {
  std::size_t number = 0;
  std::int64_t stamp_ns = 0;
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
};

std::int64_t stamp_ns_of(const StampedPose& pose) {
  return pose.stamp_ns;
}
std::int64_t stamp_ns_of(const Sweep& sweep) {
  return sweep.stamp_ns;
}

/// Sorts by stamp, and keeps one entry per stamp.
template <class T>
std::vector<T> in_order(std::vector<T> all, const std::string& what, const std::string& source,
                        Problems& problems) {
  for (std::size_t i = 1; i < all.size(); ++i) {
    const double back_s = seconds(stamp_ns_of(all[i]), stamp_ns_of(all[i - 1]));
    if (back_s <= 0.0) continue;
    problems.add_altered(what + " stamps run backwards, sorted",
                         at(source, stamp_ns_of(all[i])) + ", by " + std::to_string(back_s) + " s");
  }
  const auto earlier = [](const T& a, const T& b) { return stamp_ns_of(a) < stamp_ns_of(b); };
  std::stable_sort(all.begin(), all.end(), earlier);
  std::vector<T> out;
  for (T& entry : all) {
    if (!out.empty() && stamp_ns_of(out.back()) == stamp_ns_of(entry)) {
      problems.add_altered(what + (what == "sweep" ? "" : " pose") + " of a repeated stamp left out",
                           at(source, stamp_ns_of(entry)));
    } else {
      out.push_back(std::move(entry));
    }
  }
  return out;
}

std::vector<StampedPose> usable_odometry(const RobotStream& stream, Problems& problems) {
  std::vector<StampedPose> usable;
  for (const StampedPose& pose : stream.odometry) {
    if (!parts::stamp_in_range(pose.stamp_ns)) {
      problems.add_altered("stamp out of range left out", at(stream.source, pose.stamp_ns));
    } else if (!pose.pose.matrix().allFinite()) {
      problems.add_altered("odometry pose not finite left out", at(stream.source, pose.stamp_ns));
    } else {
      usable.push_back({pose.stamp_ns, se3::normalized(pose.pose)});
    }
  }
  return in_order(std::move(usable), "odometry", stream.source, problems);
}

std::vector<Sweep> usable_sweeps(const RobotStream& stream, Problems& problems) {
  std::vector<Sweep> usable;
  for (std::size_t i = 0; i < stream.sweep_stamps_ns.size(); ++i) {
    const std::int64_t stamp = stream.sweep_stamps_ns[i];
    if (parts::stamp_in_range(stamp)) {
      usable.push_back({i, stamp, Eigen::Isometry3d::Identity()});
    } else {
      problems.add_altered("stamp out of range left out", at(stream.source, stamp));
    }
  }
  return in_order(std::move(usable), "sweep", stream.source, problems);
}

/// First entry at or after a stamp.
template <class T>
typename std::vector<T>::const_iterator first_at(const std::vector<T>& all, std::int64_t stamp_ns) {
  return std::lower_bound(all.begin(), all.end(), stamp_ns,
                          [](const T& entry, std::int64_t stamp) { return stamp_ns_of(entry) < stamp; });
}

/// A pose of the odometry, and its distance in time from the requested stamp.
struct TimedPose {
  Eigen::Isometry3d pose;
  double off_s = 0.0;
};

/// The pose at a stamp, if the odometry has a pose within `max_difference_s`. Interpolates between the
/// neighbours if they are close enough in time.
std::optional<TimedPose> pose_at(const std::vector<StampedPose>& odometry, std::int64_t stamp_ns,
                                 double max_difference_s) {
  const auto after = first_at(odometry, stamp_ns);
  const auto before = after == odometry.begin() ? odometry.end() : std::prev(after);
  const bool has_after = after != odometry.end(), has_before = before != odometry.end();
  const double until_s = has_after ? seconds(stamp_ns, after->stamp_ns) : kNever_s;
  const double since_s = has_before ? seconds(before->stamp_ns, stamp_ns) : kNever_s;
  if ((!has_before && !has_after) || std::min(since_s, until_s) > max_difference_s) return std::nullopt;
  if (until_s == 0.0) return TimedPose{after->pose, 0.0};
  const double longest_s = std::max(kLongestStep_s, 2.0 * max_difference_s);
  if (has_before && has_after && seconds(before->stamp_ns, after->stamp_ns) <= longest_s) {
    const Vector6d step = se3::log(before->pose.inverse() * after->pose);
    return TimedPose{se3::normalized(before->pose * se3::exp(since_s / (since_s + until_s) * step)), 0.0};
  }
  if (has_after && until_s < since_s) return TimedPose{after->pose, until_s};
  return has_before ? TimedPose{before->pose, since_s} : TimedPose{after->pose, until_s};
}

bool has_sweep_near(const std::vector<Sweep>& sweeps, std::int64_t stamp_ns, double max_difference_s) {
  const auto after = first_at(sweeps, stamp_ns);
  return (after != sweeps.end() && seconds(stamp_ns, after->stamp_ns) <= max_difference_s) ||
         (after != sweeps.begin() && seconds(std::prev(after)->stamp_ns, stamp_ns) <= max_difference_s);
}

/// Counts gaps in the data during which the sensor moved.
template <class T>
void count_gaps(const std::vector<T>& all, const char* kind, const std::string& source,
                const MissionOptions& options, Problems& problems) {
  if (all.size() < 3) return;
  std::vector<double> intervals;
  for (std::size_t i = 1; i < all.size(); ++i)
    intervals.push_back(seconds(stamp_ns_of(all[i - 1]), stamp_ns_of(all[i])));
  std::vector<double> sorted = intervals;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  const double longest = std::max(kLeastGap_s, kUsualGaps * *middle);
  for (std::size_t i = 1; i < all.size(); ++i) {
    const double moved = (all[i].pose.translation() - all[i - 1].pose.translation()).norm();
    if (intervals[i - 1] <= longest || moved < options.keyframe_distance_m) continue;
    problems.add(kind, at(source, stamp_ns_of(all[i - 1])) + ", for " + std::to_string(intervals[i - 1]) +
                           " s, in which it moves " + std::to_string(moved) + " m");
  }
}

void count_jumps(const std::vector<StampedPose>& odometry, const std::string& source, Problems& problems) {
  for (std::size_t i = 1; i < odometry.size(); ++i) {
    const double moved = (odometry[i].pose.translation() - odometry[i - 1].pose.translation()).norm();
    const double time_s = seconds(odometry[i - 1].stamp_ns, odometry[i].stamp_ns);
    if (moved > kLeastJump_m && moved > kLargestSpeed_mps * time_s) {
      problems.add("odometry jumps", at(source, odometry[i].stamp_ns) + ", by " + std::to_string(moved) +
                                         " m in " + std::to_string(time_s) + " s");
    }
  }
}

template <class T>
std::string range_text(const std::vector<T>& all) {
  if (all.empty()) return "none";
  return std::to_string(seconds(0, stamp_ns_of(all.front()))) + " to " +
         std::to_string(seconds(0, stamp_ns_of(all.back()))) + " s";
}

/// The sweeps whose pose is known.
std::vector<Sweep> with_poses(const RobotStream& stream, const std::vector<StampedPose>& odometry,
                              const std::vector<Sweep>& sweeps, const MissionOptions& options,
                              Problems& problems) {
  const double nearest_s = options.keyframe_max_time_difference_s;
  std::vector<Sweep> posed;
  for (Sweep sweep : sweeps) {
    if (const auto found = pose_at(odometry, sweep.stamp_ns, nearest_s)) {
      sweep.pose = found->pose;
      posed.push_back(sweep);
      if (found->off_s > kSameTime_s) {
        problems.add_altered(
            "sweep with the pose of another time",
            at(stream.source, sweep.stamp_ns) + ", " + std::to_string(found->off_s) + " s off");
      }
    } else {
      problems.add_altered("sweep without odometry near in time left out", at(stream.source, sweep.stamp_ns));
    }
  }
  for (const StampedPose& pose : odometry) {
    if (!has_sweep_near(sweeps, pose.stamp_ns, nearest_s))
      problems.add("odometry pose without a sweep near in time", at(stream.source, pose.stamp_ns));
  }
  if (posed.empty()) {
    throw InputError(stream.source + ": no sweep is within " + std::to_string(nearest_s) +
                     " s of a pose of the odometry: the stamps of its " + std::to_string(odometry.size()) +
                     " poses are " + range_text(odometry) + ", those of its " +
                     std::to_string(sweeps.size()) + " sweeps " + range_text(sweeps) +
                     ": both must use the same clock; mission.keyframe_max_time_difference_s sets the limit");
  }
  return posed;
}

bool is_far(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, const MissionOptions& options) {
  const Eigen::Isometry3d T = a.inverse() * b;
  return T.translation().norm() >= options.keyframe_distance_m ||
         se3::so3_log(T.linear()).norm() >= options.keyframe_angle_rad;
}

/// Assigns each sweep to the key frame that is nearest in time.
void make_submaps(std::vector<SelectedKeyFrame>& key_frames, const std::vector<Sweep>& sweeps,
                  const std::string& source, const MissionOptions& options, Problems& problems) {
  std::vector<std::vector<const Sweep*>> owned(key_frames.size());
  std::size_t k = 0;
  for (const Sweep& sweep : sweeps) {
    const auto distance = [&](std::size_t n) { return std::abs(sweep.stamp_ns - key_frames[n].stamp_ns); };
    while (k + 1 < key_frames.size() && distance(k + 1) <= distance(k)) ++k;
    owned[k].push_back(&sweep);
  }
  const auto most = static_cast<std::size_t>(options.submap_sweeps);
  for (std::size_t n = 0; n < key_frames.size(); ++n) {
    SelectedKeyFrame& frame = key_frames[n];
    std::vector<const Sweep*>& own = owned[n];
    if (own.size() > most) {
      problems.add("sweep beyond submap_sweeps left out of a submap", at(source, frame.stamp_ns),
                   own.size() - most);
      std::stable_sort(own.begin(), own.end(), [&](const Sweep* a, const Sweep* b) {
        return std::abs(a->stamp_ns - frame.stamp_ns) < std::abs(b->stamp_ns - frame.stamp_ns);
      });
      own.resize(most);
      std::sort(own.begin(), own.end(),
                [](const Sweep* a, const Sweep* b) { return a->stamp_ns < b->stamp_ns; });
    }
    for (const Sweep* sweep : own)
      frame.submap.push_back({sweep->number, se3::normalized(frame.pose.inverse() * sweep->pose)});
  }
}

/// Appends a sweep to a cloud in another frame. Normals and intensities are kept only if all sweeps have
/// them.
void append_moved(const PointCloud& sweep, const Eigen::Isometry3d& T, PointCloud& cloud) {
  const Eigen::Isometry3f T_float = T.cast<float>();
  const bool first = cloud.empty();
  const bool normals = sweep.has_normals() && (first || cloud.has_normals());
  const bool intensities = !sweep.intensities.empty() && (first || !cloud.intensities.empty());
  for (const Eigen::Vector3f& point : sweep.points) cloud.points.push_back(T_float * point);
  if (normals) {
    for (const Eigen::Vector3f& normal : sweep.normals) cloud.normals.push_back(T_float.linear() * normal);
  } else {
    cloud.normals.clear();
  }
  if (intensities) {
    cloud.intensities.insert(cloud.intensities.end(), sweep.intensities.begin(), sweep.intensities.end());
  } else {
    cloud.intensities.clear();
  }
}

/// The scan of a key frame, from its sweeps.
CloudFile read_scan(const SweepReader& read, std::size_t stream, const SelectedKeyFrame& frame) {
  if (frame.submap.size() <= 1) return read(stream, frame.sweep);
  CloudFile scan;
  for (const SubmapSweep& part : frame.submap) {
    try {
      CloudFile sweep = read(stream, part.sweep);
      if (!sweep.cloud.origin.isZero(0.0)) return sweep;  // refused later, as all scans in world coordinates
      if (!sweep.cloud.empty()) append_moved(sweep.cloud, part.T_key_sweep, scan.cloud);
      scan.problems.add(sweep.problems);
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      if (part.sweep == frame.sweep) throw;
      scan.problems.add_altered("sweep of a submap cannot be read", error.what());
    }
  }
  const auto in_range = [](const Eigen::Vector3f& point) {
    return point.cwiseAbs().maxCoeff() <= kFarthest_m;
  };
  if (!std::all_of(scan.cloud.points.begin(), scan.cloud.points.end(), in_range))
    throw InputError("submap of sweep " + std::to_string(frame.sweep) + ": odometry jumps within it");
  return scan;
}

/// Source of the scan of a node.
struct Source {
  std::size_t stream = 0;
  SelectedKeyFrame frame;
};

/// Parts of the mission from the streams added so far.
struct Parts {
  PoseGraph graph;
  parts::Stamps stamps;
  std::vector<Robot> robots;
  std::map<Key, Source> sources;
  std::vector<std::string> at_origin;  // robots that begin at the origin
};

void add_stream(const RobotStream& stream, std::size_t number, bool alone, const MissionOptions& options,
                Problems& problems, Parts& to) {
  std::vector<SelectedKeyFrame> key_frames = choose_key_frames(stream, options, problems);
  const char letter = static_cast<char>('a' + number);
  to.robots.push_back(alone ? Robot{stream.name, 0, key_frames.size() - 1, false}
                            : robot_of_character(letter, stream.name));
  const Key first = alone ? 0 : make_key(letter, 0);
  if (key_frames.front().pose.translation().norm() < kAtOrigin_m) to.at_origin.push_back(stream.name);
  for (std::size_t i = 0; i < key_frames.size(); ++i) {
    Node node;
    node.key = first + i;
    node.pose = key_frames[i].pose;
    to.graph.add_node(node);
    to.stamps.emplace(node.key, key_frames[i].stamp_ns);
    if (i == 0) continue;
    const Eigen::Isometry3d T = se3::normalized(key_frames[i - 1].pose.inverse() * key_frames[i].pose);
    to.graph.add_edge({node.key - 1, node.key, T, odometry_information(T, options)});
  }
  for (std::size_t i = 0; i < key_frames.size(); ++i)
    to.sources.emplace(first + i, Source{number, std::move(key_frames[i])});
}

}  // namespace

std::vector<SelectedKeyFrame> choose_key_frames(const RobotStream& stream, const MissionOptions& options,
                                                Problems& problems) {
  const std::vector<StampedPose> odometry = usable_odometry(stream, problems);
  const std::vector<Sweep> sweeps =
      with_poses(stream, odometry, usable_sweeps(stream, problems), options, problems);
  count_gaps(odometry, "gap in the odometry", stream.source, options, problems);
  count_gaps(sweeps, "gap in the sweeps", stream.source, options, problems);
  count_jumps(odometry, stream.source, problems);
  std::vector<SelectedKeyFrame> key_frames;
  for (const Sweep& sweep : sweeps) {
    if (key_frames.empty() || is_far(key_frames.back().pose, sweep.pose, options))
      key_frames.push_back({sweep.number, sweep.stamp_ns, sweep.pose, {}});
  }
  if (options.submap_sweeps > 0) make_submaps(key_frames, sweeps, stream.source, options, problems);
  return key_frames;
}

Mission make_key_frame_mission(const std::vector<RobotStream>& streams, SweepReader read,
                               const MissionOptions& options) {
  validate(options);
  if (streams.empty()) throw InputError("no stream of odometry and sweeps");
  if (streams.size() > kStreamLetters) {
    throw InputError(streams.front().source + ": " + std::to_string(streams.size()) + " robots, at most " +
                     std::to_string(kStreamLetters) + " can be read, because each needs a letter");
  }
  Mission mission;
  Parts made;
  for (std::size_t i = 0; i < streams.size(); ++i) {
    try {
      add_stream(streams[i], i, streams.size() == 1, options, mission.problems, made);
    } catch (const InputError& error) {
      const std::string what = error.what();
      const bool named = what.rfind(streams[i].source, 0) == 0;
      throw InputError(named ? what : streams[i].source + ": " + what);
    }
  }
  for (std::size_t i = 0; made.at_origin.size() > 1 && i < made.at_origin.size(); ++i) {
    mission.problems.add("joined without a frame",
                         made.at_origin[i] + ": its origin is assumed to be that of the common frame");
  }
  mission.robots = parts::robots_of(made.graph, options, Robots(std::move(made.robots)));
  std::vector<PriorFactor> priors;
  parts::complete_priors(made.graph, mission.robots, options, streams.front().source, priors,
                         mission.problems);
  mission.graph = parts::assemble(made.graph, made.stamps, priors, mission.robots, options, mission.problems);
  parts::check_stamps(mission);
  const auto sources = std::make_shared<const std::map<Key, Source>>(std::move(made.sources));
  parts::set_scans(
      mission, parts::key_frames(mission.graph, mission.robots),
      [sources, read = std::move(read)](Key key) {
        const Source& source = sources->at(key);
        return read_scan(read, source.stream, source.frame);
      },
      [](Key key) { return key_name(key); }, options);
  return mission;
}

}  // namespace loopwise
