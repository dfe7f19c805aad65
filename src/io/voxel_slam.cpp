// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/key_frames.hpp>

#include "saved_maps.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;

struct Session {
  RobotStream stream;
  std::vector<fs::path> clouds;  // of each sweep
};

/// Each line has a stamp, position and quaternion, followed by velocity, biases, gravity and variances.
Session read_voxel_session(const fs::path& folder, Problems& problems) {
  Session session;
  session.stream.name = name_of(folder);
  session.stream.source = (folder / "alidarState.txt").string();
  const std::map<Key, fs::path> clouds = numbered_clouds(folder, problems);
  const std::string& name = session.stream.source;
  const std::string contents = read_file(name);
  text::Lines lines(contents);
  Key row = 0;
  for (std::string_view line; lines.next(line);) {
    std::string_view rest = line;
    const std::string_view word = text::next_word(rest);
    if (word.empty()) continue;
    const text::Place place{name, lines.number()};
    const auto stamp = text::parse_seconds_ns(word);
    if (!stamp) place.fail(text::quoted(word) + " is not a stamp in seconds");
    double values[7];
    const std::size_t found = text::read_numbers(rest, values, 7, place);
    if (found < 7) {
      place.fail("a state of Voxel-SLAM needs at least 8 values (stamp x y z qx qy qz qw), found " +
                 std::to_string(found + 1));
    }
    const text::Pose pose = text::pose_of(values, place);
    if (!pose.was_unit) problems.add_altered("non-unit quaternion", place.str());
    session.stream.odometry.push_back({*stamp, pose.pose});
    if (const auto cloud = clouds.find(row); cloud != clouds.end()) {
      session.stream.sweep_stamps_ns.push_back(*stamp);
      session.clouds.push_back(cloud->second);
    }
    ++row;
  }
  for (auto cloud = clouds.lower_bound(row); cloud != clouds.end(); ++cloud)
    problems.add_altered("row beyond the common part left out",
                         cloud->second.string() + ": no state has its number");
  problems.add("odometry taken from the optimised poses",
               name + ": it has no drift; --odometry-noise adds some");
  return session;
}

std::size_t count_lines(const fs::path& file) {
  if (!fs::is_regular_file(file)) return 0;
  const std::string contents = read_file(file);
  std::size_t count = 0;
  text::Lines lines(contents);
  for (std::string_view line; lines.next(line);) count += text::next_word(line).empty() ? 0 : 1;
  return count;
}

}  // namespace

Mission read_voxel_slam(const fs::path& folder, const MissionOptions& options) {
  Problems problems;
  std::vector<fs::path> folders;
  if (fs::is_regular_file(folder / "alidarState.txt")) {
    folders.push_back(folder);
  } else {
    for (const fs::path& entry : entries(folder)) {
      if (fs::is_regular_file(entry / "alidarState.txt")) folders.push_back(entry);
    }
  }
  problems.add("closure of the session's own graph left out", (folder / "edge.txt").string(),
               count_lines(folder / "edge.txt"));
  std::vector<RobotStream> streams;
  std::vector<std::vector<fs::path>> clouds;
  std::vector<std::string> sources;
  for (const fs::path& own : folders) {
    Session session = read_voxel_session(own, problems);
    sources.push_back(own.filename().string());
    streams.push_back(std::move(session.stream));
    clouds.push_back(std::move(session.clouds));
  }
  const auto read = [clouds, layout = options.bin_layout](std::size_t stream, std::size_t sweep) {
    return read_cloud(clouds[stream][sweep], layout);
  };
  Mission mission = make_key_frame_mission(streams, read, options);
  problems.add(mission.problems);
  mission.problems = std::move(problems);
  mission.kind = MissionKind::kVoxelSlam;
  mission.path = folder;
  mission.name = name_of(folder);
  mission.provenance_json = provenance_of(mission.kind, sources);
  return mission;
}

}  // namespace loopwise::parts
