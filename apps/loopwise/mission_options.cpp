// SPDX-License-Identifier: BSD-3-Clause
#include "mission_options.hpp"

#include <sstream>

#include <loopwise/core/error.hpp>

#include "units.hpp"

namespace loopwise::cli {

void apply(const MissionArguments& arguments, Config& config) {
  MissionOptions& mission = config.mission;
  if (!arguments.robots.empty()) mission.robots = arguments.robots;
  if (!arguments.odometry.empty())
    mission.odometry = arguments.odometry == "consecutive" ? std::string() : arguments.odometry;
  if (!arguments.frames.empty()) mission.frames = arguments.frames;
  if (arguments.start_together) mission.start_together = true;
  if (!arguments.bin_layout.empty())
    mission.bin_layout = parse_enum<BinLayout>("--bin-layout", arguments.bin_layout);
}

void add_robots_option(Command& command, std::string& robots) {
  command.add_option("--robots", robots, "Robots by ranges of ids or by characters")->type_name("LIST");
}

void add_odometry_option(Command& command, std::string& odometry) {
  command
      .add_option("--odometry", odometry,
                  "Which edges are odometry: a file with two keys per line, or the word consecutive: those "
                  "between neighbours of a robot (default)")
      ->type_name("FILE");
}

void add_decisions_option(Command& command, std::string& decisions) {
  command
      .add_option("--decisions", decisions,
                  "Closures that a person has accepted or rejected: a file that the report has saved")
      ->type_name("decisions.csv");
}

void add_bin_layout_option(Command& command, std::string& layout) {
  command
      .add_option("--bin-layout", layout,
                  "Points of .bin files: auto (default), xyz, xyzi, xyzir, xyzirt, xyz_double, xyzi_double, "
                  "helipr_ouster, helipr_velodyne, helipr_avia, helipr_aeva or helipr_aeva_intensity")
      ->type_name("WORD");
}

void add_joining_options(Command& command, MissionArguments& arguments) {
  command
      .add_option("--frames", arguments.frames,
                  "Several missions: pose of each one's frame in the common frame, CSV "
                  "(source,x,y,z,qx,qy,qz,qw or source,x,y,z,yaw, with sigmas or without) or TUM; for "
                  "convert and replay also auto: found from the scans, or common: poses unchanged")
      ->type_name("FILE");
  command.add_flag("--start-together", arguments.start_together,
                   "Several missions: all begin at the same time");
}

void add_key_frame_options(Command& command, CommonOptions& options) {
  const auto assign = [&options](const char* field) {
    return [&options, field](const std::string& value) {
      options.reading.push_back("mission." + std::string(field) + "=" + value);
    };
  };
  command
      .add_option_function<std::string>("--keyframe-distance", assign("keyframe_distance_m"),
                                        "Odometry with sweeps: a key frame after M metres (default 1)")
      ->type_name("M");
  command
      .add_option_function<double>(
          "--keyframe-angle",
          [&options](double degrees) {
            std::ostringstream text;
            text.precision(17);
            text << "mission.keyframe_angle_rad=" << degrees / kDegreesPerRadian;
            options.reading.push_back(text.str());
          },
          "Odometry with sweeps: a key frame after a turn of DEG degrees (default 20)")
      ->type_name("DEG");
  command
      .add_option_function<std::string>("--submap", assign("submap_sweeps"),
                                        "Odometry with sweeps: join up to N sweeps around a key frame to its "
                                        "scan (default 0: its own sweep only)")
      ->type_name("N");
  command
      .add_option_function<std::string>("--poses", assign("poses"),
                                        "Folders of sweeps: file with their poses, KITTI rows or TUM")
      ->type_name("FILE");
  command
      .add_option_function<std::string>("--odometry-topic", assign("odometry_topic"),
                                        "Bags without graphs: topic of the odometry, whole or within each "
                                        "robot's namespace")
      ->type_name("NAME");
  command
      .add_option_function<std::string>("--cloud-topic", assign("cloud_topic"),
                                        "Bags without graphs: topic of the clouds, in the same way")
      ->type_name("NAME");
  command
      .add_option_function<std::string>("--truth-topic", assign("truth_topic"),
                                        "Bags without graphs: topic of true poses, in the same way")
      ->type_name("NAME");
}

void add_truth_option(Command& command, std::vector<std::string>& truth) {
  command
      .add_option("--truth", truth,
                  "True poses of the nodes, TUM, KITTI or g2o, in place of recorded ones; for several robots "
                  "one file each; may be repeated")
      ->type_name("[ROBOT=]FILE")
      ->expected(1)
      ->take_all();
}

std::vector<std::string> truth_of_mission(const std::vector<std::string>& truth, std::size_t mission,
                                          std::size_t missions) {
  if (truth.empty() || missions == 1) return truth;
  if (truth.size() != missions) {
    throw OptionError("--truth is given " + std::to_string(truth.size()) + " times for " +
                      std::to_string(missions) + " missions: give one file for each, in their order");
  }
  return {truth[mission]};
}

}  // namespace loopwise::cli
