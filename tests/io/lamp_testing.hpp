// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Data that lamp_data.py writes with independent writers, and the values that must be read from them.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/optimizer.hpp>

#include "bag.hpp"
#include "testing.hpp"
#include "zip_archive.hpp"

namespace loopwise::testing {

/// Debian's modules belong to the system's own Python, not to one that stands before it in the path.
constexpr const char* kPython = "/usr/bin/python3";

inline bool run_lamp_data(const std::string& arguments) {
  const std::string command =
      std::string(kPython) + " '" + LOOPWISE_SOURCE_DIR + "/tests/io/lamp_data.py' " + arguments;
  return std::system(command.c_str()) == 0;
}

/// Writes one form of the data into `folder`. \returns false, with a visible message, if a required package
/// is missing: the test then returns at once.
inline bool lamp_data(const std::string& form, const fs::path& folder, const std::string& arguments = {}) {
  const bool needs_rosbag = form != "g2o_pcd" && form != "sessions";
  const auto skip = [](const std::string& why) {
    std::cerr << "SKIPPED: " << why << "\n";
    SUCCEED("skipped");
    return false;
  };
  static const bool python = std::system((std::string(kPython) + " -c '' 2>/dev/null").c_str()) == 0;
  static const bool rosbag = python && run_lamp_data("probe none 2>/dev/null");
  if (!python) return skip(std::string(kPython) + " is absent");
  if (needs_rosbag && !rosbag) return skip("python3-rosbag is absent: no bags to read");
  if (needs_rosbag && !bags::available()) return skip(bags::kUnavailable);
  REQUIRE(run_lamp_data(form + " '" + folder.string() + "' " + arguments));
  return true;
}

/// The same as bags of ROS 2, and forms of rosbag2_data.py's own.
inline bool rosbag2_data(const std::string& form, const fs::path& folder, const std::string& arguments = {}) {
  if (!bags::rosbag2_available()) {
    std::cerr << "SKIPPED: " << bags::kRosbag2Unavailable << "\n";
    SUCCEED("skipped");
    return false;
  }
  if (!lamp_data("probe", folder)) return false;  // its messages are python3-rosbag's
  const std::string command = std::string(kPython) + " '" + LOOPWISE_SOURCE_DIR +
                              "/tests/io/rosbag2_data.py' " + form + " '" + folder.string() + "' " +
                              arguments;
  REQUIRE(std::system(command.c_str()) == 0);
  return true;
}

inline Json expected_of(const fs::path& folder) {
  return parse_json(read_file(folder / "expected.json"), "expected.json");
}

inline Eigen::Isometry3d pose_of(const Json& numbers) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() << numbers[0].get<double>(), numbers[1].get<double>(), numbers[2].get<double>();
  T.linear() = Eigen::Quaterniond(numbers[6].get<double>(), numbers[3].get<double>(),
                                  numbers[4].get<double>(), numbers[5].get<double>())
                   .normalized()
                   .toRotationMatrix();
  return T;
}

/// Translation first, from 36 numbers with the rotation first.
inline Matrix6d covariance_of(const Json& numbers) {
  Matrix6d out;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      out((i + 3) % 6, (j + 3) % 6) = numbers[static_cast<std::size_t>(6 * i + j)].get<double>();
    }
  }
  return out;
}

inline Key key_of(const Json& text) {
  return parse_key(text.get_ref<const std::string&>());
}

/// The information of a covariance. Measured: the reader's differs by 2e-15 of its size.
inline void check_information(const Matrix6d& information, const Json& covariance) {
  CHECK((information * covariance_of(covariance) - Matrix6d::Identity()).cwiseAbs().maxCoeff() < 1e-10);
  CHECK(information == information.transpose());
}

inline void check_nodes(const Mission& mission, const Json& expected, bool stamps = true) {
  const auto frames = std::count_if(mission.graph.nodes().begin(), mission.graph.nodes().end(),
                                    [&](const Node& node) { return !mission.robots.is_landmark(node.key); });
  REQUIRE(static_cast<std::size_t>(frames) == expected["nodes"].size());
  for (const Json& node : expected["nodes"]) {
    const Key key = key_of(node["key"]);
    CAPTURE(key_name(key));
    REQUIRE(mission.graph.contains(key));
    CHECK(difference(mission.graph.node(key).pose, pose_of(node["pose"])) < 1e-12);
    if (stamps) CHECK(std::to_string(mission.graph.node(key).stamp_ns) == node["stamp_ns"]);
  }
}

inline const Edge* find_edge(const PoseGraph& graph, Key from, Key to) {
  for (const Edge& edge : graph.edges()) {
    if (edge.from == from && edge.to == to) return &edge;
  }
  return nullptr;
}

inline void check_edge(const Mission& mission, const Json& expected, EdgeKind kind) {
  const Edge* const edge = find_edge(mission.graph, key_of(expected["from"]), key_of(expected["to"]));
  CAPTURE(expected["from"], expected["to"]);
  REQUIRE(edge != nullptr);
  CHECK(edge->kind == kind);
  CHECK(difference(edge->T_from_to, pose_of(expected["pose"])) < 1e-12);
  check_information(edge->information, expected["covariance"]);
}

inline void check_odometry(const Mission& mission, const Json& expected) {
  for (const Json& edge : expected["edges"]) check_edge(mission, edge, EdgeKind::kOdometry);
}

inline void check_priors(const Mission& mission, const Json& expected) {
  REQUIRE(mission.graph.priors().size() == expected["priors"].size());
  for (const Json& prior : expected["priors"]) {
    const auto found = std::find_if(mission.graph.priors().begin(), mission.graph.priors().end(),
                                    [&](const PriorFactor& p) { return p.key == key_of(prior["key"]); });
    REQUIRE(found != mission.graph.priors().end());
    CHECK(difference(found->pose, pose_of(prior["pose"])) < 1e-12);
    check_information(found->information, prior["covariance"]);
  }
}

inline void check_scans(const Mission& mission, const Json& expected) {
  REQUIRE(mission.scans->size() == expected["scans"].size());
  for (const auto& item : expected["scans"].items()) {
    CAPTURE(item.key());
    const auto cloud = mission.scans->load(parse_key(item.key()));
    REQUIRE(cloud);
    const Json& scan = item.value();
    REQUIRE(cloud->size() == scan["points"].size());
    REQUIRE(cloud->intensities.size() == cloud->size());
    REQUIRE(cloud->normals.size() == scan["normals"].size());
    for (std::size_t i = 0; i < cloud->size(); ++i) {
      for (int k = 0; k < 3; ++k) {
        const auto axis = static_cast<std::size_t>(k);
        REQUIRE(cloud->points[i][k] == scan["points"][i][axis].get<float>());
        // The reader makes them of unit length again.
        if (!cloud->normals.empty()) {
          REQUIRE(std::abs(cloud->normals[i][k] - scan["normals"][i][axis].get<float>()) < 1e-6f);
        }
      }
      REQUIRE(cloud->intensities[i] == scan["intensities"][i].get<float>());
    }
  }
  CHECK(mission.scans->problems().empty());
}

inline void check_truth(const Mission& mission, const Json& expected) {
  REQUIRE(mission.ground_truth.size() == expected["truth"].size());
  for (const auto& item : expected["truth"].items()) {
    CHECK(difference(mission.ground_truth.at(parse_key(item.key())), pose_of(item.value())) < 1e-12);
  }
}

/// Compares the optimum of the mission's factors with the poses computed by hand. The orientation of
/// artifacts is unknown.
inline void check_optimum(const Mission& mission, const Json& expected) {
  const OptimizationResult result = optimize(mission.graph);
  CHECK(result.converged);
  CHECK_FALSE(result.underdetermined);
  CHECK(result.held.empty());
  for (const auto& item : expected["optimum"].items()) {
    CAPTURE(item.key());
    const Key key = parse_key(item.key());
    const Eigen::Isometry3d pose = pose_of(item.value());
    const Eigen::Isometry3d& found = result.poses[mission.graph.index_of(key)];
    // The prior of anchor u1 pulls at its ranges, by 9e-5 m, and through them at robot e, by 5e-5 m and 9e-6;
    // all else is within 1e-14. A factor that is not there or weighs wrongly shows in centimetres.
    CHECK((found.translation() - pose.translation()).norm() < 1e-3);
    if (key_character(key) != 'E') {
      CHECK((found.linear() - pose.linear()).cwiseAbs().maxCoeff() < 1e-4);
    }
  }
}

inline std::vector<std::string> names_of(const Robots& robots) {
  std::vector<std::string> names;
  for (const Robot& robot : robots.all()) names.push_back(robot.name);
  return names;
}

}  // namespace loopwise::testing
