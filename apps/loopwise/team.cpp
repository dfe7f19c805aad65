// SPDX-License-Identifier: BSD-3-Clause
#include "team.hpp"

#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/json_values.hpp>

#include "units.hpp"

namespace loopwise::cli {
namespace {

double yaw_of(const Eigen::Isometry3d& pose) {
  return std::atan2(pose(1, 0), pose(0, 0));
}

std::string frame_text(const ComponentFrame& frame) {
  const Eigen::Vector3d t = frame.pose.translation();
  const double sigma_m = std::sqrt(frame.covariance.topLeftCorner<3, 3>().diagonal().maxCoeff());
  const double sigma_rad = std::sqrt(frame.covariance.bottomRightCorner<3, 3>().diagonal().maxCoeff());
  return "at " + fixed(t.x(), 2) + " " + fixed(t.y(), 2) + " " + fixed(t.z(), 2) + " m, yaw " +
         fixed(yaw_of(frame.pose) * kDegreesPerRadian, 2) + " deg; sigma " + fixed(sigma_m, 2) + " m, " +
         fixed(sigma_rad * kDegreesPerRadian, 2) + " deg by the stated odometry";
}

Json tie_json(const TeamFrames& frames, const Tie& tie) {
  return {{"a", frames.components[tie.a].name},
          {"b", frames.components[tie.b].name},
          {"joined", tie.joined},
          {"reason", tie.reason},
          {"computed", tie.computed},
          {"verified", tie.verified},
          {"closures", tie.closures.size()},
          {"places", tie.places},
          {"tested", tie.tested},
          {"confirmed", tie.confirmed},
          {"rival_closures", tie.rival_closures},
          {"rival_confirmed", tie.rival_confirmed},
          {"best_overlap", tie.best_overlap},
          {"sigma_m", tie.sigma_m},
          {"sigma_rad", tie.sigma_rad},
          {"T_a_b", tie.T_a_b ? row_major_json(tie.T_a_b->matrix()) : Json()}};
}

bool is_joined(const TeamFrames& frames, std::size_t component) {
  std::size_t members = 0;
  for (const ComponentFrame& frame : frames.result.frames)
    members += frame.group == frames.result.frames[component].group ? 1 : 0;
  return frames.result.frames[component].group == 0 && members > 1;
}

}  // namespace

std::string frames_text(const TeamFrames& frames) {
  std::string text = "frames       " + std::to_string(frames.result.computed) + " pairs registered\n";
  bool first = true;
  for (std::size_t c = 0; c < frames.components.size(); ++c) {
    const ComponentFrame& frame = frames.result.frames[c];
    const bool joined = is_joined(frames, c);
    text += "  " + frames.components[c].name + ": ";
    if (!joined) {
      text += "apart: " + frame.reason;
    } else if (first) {
      text += "the common frame";
      first = false;
    } else {
      text += frame_text(frame) + "; " + frame.reason;
    }
    text += "\n";
  }
  return text;
}

Json frames_json(const TeamFrames& frames) {
  Json components = Json::array(), ties = Json::array();
  for (std::size_t c = 0; c < frames.components.size(); ++c) {
    const ComponentFrame& frame = frames.result.frames[c];
    const bool joined = is_joined(frames, c);
    Json sigmas = Json::array();
    for (int i = 0; i < 6; ++i) sigmas.push_back(std::sqrt(frame.covariance(i, i)));
    components.push_back({{"name", frames.components[c].name},
                          {"joined", joined},
                          {"group", frame.group},
                          {"T_common_component", joined ? row_major_json(frame.pose.matrix()) : Json()},
                          {"sigmas", joined ? sigmas : Json()},
                          {"reason", frame.reason}});
  }
  for (const Tie& tie : frames.result.ties) ties.push_back(tie_json(frames, tie));
  return {{"pairs", frames.result.computed},
          {"groups", frames.result.groups},
          {"components", std::move(components)},
          {"ties", std::move(ties)}};
}

}  // namespace loopwise::cli
