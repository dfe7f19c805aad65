// SPDX-License-Identifier: BSD-3-Clause
#include "lamp_messages.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "mission_parts.hpp"

namespace loopwise::lamp {
namespace {

/// The constants of pose_graph_msgs/PoseGraphEdge.
enum EdgeType : std::int64_t {
  kOdom = 0,
  kPrior = 1,
  kImu = 2,
  kLoopClose = 3,
  kArtifact = 4,
  kUwbRange = 5,
  kUwbBetween = 6,
};

/// A rotation is wrong by at most half a turn, so a larger sigma adds nothing. Artifacts, of which only the
/// position is known, have a sigma of 1e5 rad. With it, the solver would take the rotation for unconstrained.
constexpr double kLargestRotationSigma = 100.0;
/// Odometry measures rotations in rad at least as precisely as lengths in m. A sigma of rotation that is
/// larger by this factor suggests the other order.
constexpr double kSwapped = 4.0;
/// Smallest eigenvalue of a covariance with unit diagonal. Below it, the inverse is noise.
constexpr double kLeastEigenvalue = 1e-10;
/// Hostnames that contain it belong to the robots' own radios.
constexpr const char* kRobotRadio = "scom-";

bool same(const SeenFactor& a, const SeenFactor& b) {
  return a.pose->matrix() == b.pose->matrix() && a.covariance == b.covariance;
}

bool same(double a, double b) {
  return a == b || (std::isnan(a) && std::isnan(b));
}

bool same(const SeenRange& a, const SeenRange& b) {
  return same(a.range_m, b.range_m) && same(a.sigma_m, b.sigma_m);
}

bool same(const SeenGravity& a, const SeenGravity& b) {
  return same(a.direction.x(), b.direction.x()) && same(a.direction.y(), b.direction.y()) &&
         same(a.direction.z(), b.direction.z()) && same(a.sigma_rad, b.sigma_rad);
}

/// Adds a factor unless it was added before. A repeated factor with other numbers is counted.
template <class Known, class Seen>
void add_once(Known& known, std::vector<Seen>& list, Seen seen, const typename Known::key_type& which,
              Problems& problems) {
  const auto [first, is_new] = known.emplace(which, list.size());
  if (is_new) {
    list.push_back(std::move(seen));
  } else if (!same(list[first->second], seen)) {
    problems.add_altered("repeated edge with other numbers", seen.where);
  }
}

std::string ends(Key from, Key to) {
  return from == to ? key_name(from) : key_name(from) + " to " + key_name(to);
}

}  // namespace

std::optional<Eigen::Isometry3d> pose_of(const ros1::Value& p, const ros1::Value& q) {
  const Eigen::Vector3d t(p.at("x").number(), p.at("y").number(), p.at("z").number());
  Eigen::Quaterniond r(q.at("w").number(), q.at("x").number(), q.at("y").number(), q.at("z").number());
  const double norm = r.norm();
  // Unset poses are all zero. A norm that differs from 1 by more than a tenth is not a rounding error.
  if (!t.allFinite() || !(std::abs(norm - 1.0) <= 0.1)) return std::nullopt;
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = r.normalized().toRotationMatrix();
  T.translation() = t;
  return T;
}

std::optional<Eigen::Isometry3d> pose_of(const ros1::Value& pose) {
  return pose_of(pose.at("position"), pose.at("orientation"));
}

std::optional<Eigen::Isometry3d> pose_of_message(const ros1::Value& message) {
  const ros1::Value pose = message.at("pose");
  return pose_of(pose.has("pose") ? pose.at("pose") : pose);
}

std::int64_t stamp_of(const ros1::Value& message, std::int64_t otherwise) {
  const std::int64_t stamp = message.at("header").at("stamp").time_ns();
  return stamp == 0 ? otherwise : stamp;
}

bool is_landmark(Key key) {
  return parts::is_landmark_character(key_character(key));
}

std::string first_word(const std::string& topic) {
  const std::size_t begin = topic.find_first_not_of('/');
  if (begin == std::string::npos) return {};
  const std::size_t end = topic.find('/', begin);
  return end == std::string::npos ? std::string() : topic.substr(begin, end - begin);
}

MessageKind message_kind(const std::string& type) {
  if (type == "pose_graph_msgs/KeyedScan") return MessageKind::kKeyedScan;
  if (type == "pose_graph_msgs/PoseGraph") return MessageKind::kPoseGraph;
  if (type == "pose_graph_msgs/CommNodeStatus") return MessageKind::kBeacons;
  if (type == "silvus_msgs/SilvusStreamscape") return MessageKind::kRadio;
  if (type == "nav_msgs/Odometry") return MessageKind::kOdometry;
  return MessageKind::kOther;
}

Gatherer::Gatherer(const MissionOptions& options, Problems& problems)
    : options_(options), problems_(problems) {}

void Gatherer::add_graph(const std::string& where, const std::string& topic, std::int64_t recorded_ns,
                         const ros1::Value& message) {
  message.at("nodes").for_each([&](const ros1::Value& node) {
    const Key key = node.at("key").unsigned_integer();
    if (!is_landmark(key)) characters_[first_word(topic)].insert(key_character(key));
    add_node(where, node, recorded_ns);
  });
  message.at("edges").for_each([&](const ros1::Value& edge) { add_factor(where, edge); });
}

void Gatherer::add_node(const std::string& where, const ros1::Value& node, std::int64_t recorded_ns) {
  const Key key = node.at("key").unsigned_integer();
  SeenNode& seen = (is_landmark(key) ? graph_.landmarks : graph_.nodes)[key];
  if (seen.pose && seen.has_stamp) return;
  if (seen.where.empty()) {
    seen.where = where;
    seen.stamp_ns = recorded_ns;
  }
  if (!seen.has_stamp) {
    const std::int64_t stamp = node.at("header").at("stamp").time_ns();
    seen.has_stamp = stamp != 0;
    if (seen.has_stamp) seen.stamp_ns = stamp;
  }
  if (!seen.pose) seen.pose = pose_of(node.at("pose"));
}

std::optional<Matrix6d> Gatherer::information(const SeenFactor& seen, bool translation_first,
                                              bool check_order) {
  if (std::all_of(seen.covariance.begin(), seen.covariance.end(), [](double v) { return v == 0.0; })) {
    return std::nullopt;
  }
  Matrix6d covariance;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) {
      const int row = translation_first ? i : (i + 3) % 6, column = translation_first ? j : (j + 3) % 6;
      covariance(row, column) = seen.covariance[static_cast<std::size_t>(6 * i + j)];
    }
  }
  covariance = 0.5 * (covariance + covariance.transpose()).eval();
  for (int i = 3; i < 6; ++i) {
    if (!(covariance(i, i) > kLargestRotationSigma * kLargestRotationSigma)) continue;
    covariance.row(i).setZero();
    covariance.col(i).setZero();
    covariance(i, i) = kLargestRotationSigma * kLargestRotationSigma;
  }
  const Vector6d variances = covariance.diagonal();
  if (!covariance.allFinite() || !(variances.minCoeff() > 0.0)) {
    problems_.add_altered("unusable covariance", seen.where);
    return std::nullopt;
  }
  if (check_order && variances.tail<3>().sum() > kSwapped * kSwapped * variances.head<3>().sum()) {
    problems_.add("odometry covariance looks swapped",
                  seen.where + ": sigmas of " + std::to_string(std::sqrt(variances.tail<3>().mean())) +
                      " rad and " + std::to_string(std::sqrt(variances.head<3>().mean())) +
                      " m; mission.odometry_covariance_order may be " +
                      enum_name(translation_first ? CovarianceOrder::kRotationFirst
                                                  : CovarianceOrder::kTranslationFirst));
  }
  const auto finite = [&](const Matrix6d& inverse) -> std::optional<Matrix6d> {
    if (inverse.allFinite()) return inverse;
    problems_.add_altered("unusable covariance", seen.where);
    return std::nullopt;
  };
  if (covariance == Matrix6d(variances.asDiagonal())) {
    return finite(variances.cwiseInverse().asDiagonal());
  }
  // Inverted with a unit diagonal, because values for metres and for radians differ by orders of magnitude.
  const Vector6d scale = variances.cwiseSqrt().cwiseInverse();
  const Matrix6d scaled = scale.asDiagonal() * covariance * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> eigen(scaled, Eigen::EigenvaluesOnly);
  const Eigen::LLT<Matrix6d> factor(scaled);
  if (factor.info() != Eigen::Success || !(eigen.eigenvalues().minCoeff() > kLeastEigenvalue)) {
    problems_.add_altered("unusable covariance", seen.where);
    return std::nullopt;
  }
  const Matrix6d inverse = scale.asDiagonal() * factor.solve(Matrix6d::Identity()) * scale.asDiagonal();
  return finite(0.5 * (inverse + inverse.transpose()));
}

void Gatherer::add_factor(const std::string& where, const ros1::Value& edge) {
  SeenFactor seen;
  seen.from = edge.at("key_from").unsigned_integer();
  seen.to = edge.at("key_to").unsigned_integer();
  seen.where = where + ": " + ends(seen.from, seen.to);
  const std::int64_t type = edge.at("type").integer();

  if (type == kImu) {
    const ros1::Value p = edge.at("pose").at("position");
    const std::vector<double> numbers = edge.at("covariance").numbers();
    // The first element of the covariance is the sigma itself.
    add_once(known_, graph_.gravities,
             SeenGravity{seen.to,
                         {p.at("x").number(), p.at("y").number(), p.at("z").number()},
                         numbers.empty() ? 0.0 : numbers.front(),
                         seen.where},
             std::make_tuple(type, seen.from, seen.to), problems_);
    return;
  }
  if (type == kUwbRange) {
    add_once(
        known_, graph_.ranges,
        SeenRange{seen.from, seen.to, edge.at("range").number(), edge.at("range_error").number(), seen.where},
        std::make_tuple(type, seen.from, seen.to), problems_);
    return;
  }

  std::vector<SeenFactor>* list = nullptr;
  bool translation_first = false;
  if (type == kOdom) {
    list = &graph_.odometry;
    translation_first = options_.odometry_covariance_order == CovarianceOrder::kTranslationFirst;
  } else if (type == kPrior) {
    list = &graph_.priors;
  } else if (type == kLoopClose) {
    list = &graph_.closures;
  } else if (type == kArtifact || type == kUwbBetween) {
    list = &graph_.sightings;
  } else {
    problems_.add_altered("edge of unknown type left out", seen.where + ", type " + std::to_string(type));
    return;
  }
  const auto [known, is_new] = known_.emplace(std::make_tuple(type, seen.from, seen.to), list->size());
  seen.pose = pose_of(edge.at("pose"));
  const std::vector<double> numbers = edge.at("covariance").numbers();
  if (numbers.size() != seen.covariance.size()) {
    throw InputError("a covariance of " + std::to_string(numbers.size()) + " numbers");
  }
  std::copy(numbers.begin(), numbers.end(), seen.covariance.begin());
  SeenFactor* const first = is_new ? nullptr : &(*list)[known->second];
  // Edges from the optimiser have no poses. A graph that is sent again has the same numbers.
  if (first != nullptr && !seen.pose) return;
  if (first != nullptr && first->pose) {
    if (!same(*first, seen)) problems_.add_altered("repeated edge with other numbers", seen.where);
    return;
  }
  if (seen.pose) seen.information = information(seen, translation_first, type == kOdom);
  if (first != nullptr) {
    *first = std::move(seen);
  } else {
    list->push_back(std::move(seen));
  }
}

void Gatherer::add_beacons(const ros1::Value& message, std::int64_t recorded_ns) {
  const std::int64_t stamp = stamp_of(message, recorded_ns);
  message.at("dropped").for_each([&](const ros1::Value& beacon) {
    const std::string name(beacon.at("hostname").text());
    if (name.empty() || name.find(kRobotRadio) != std::string::npos) return;
    drops_.emplace(name, Drop{name, beacon.at("pose_graph_key").unsigned_integer(), stamp});
  });
}

void Gatherer::add_radio(const ros1::Value& message, std::int64_t recorded_ns) {
  const std::int64_t stamp = stamp_of(message, recorded_ns);
  message.at("nodes").for_each([&](const ros1::Value& node) {
    Reading reading;
    reading.stamp_ns = stamp;
    reading.robot = std::string(node.at("robot_name").text());
    if (reading.robot.empty()) {
      const std::string label(node.at("node_label").text());
      if (label.rfind(kRobotRadio, 0) == 0) reading.robot = label.substr(std::string(kRobotRadio).size());
    }
    if (reading.robot.empty()) return;  // a beacon, not a robot
    node.at("neighbors").for_each([&](const ros1::Value& neighbor) {
      reading.beacon = std::string(neighbor.at("neighbor_node_label").text());
      if (reading.beacon.empty() || reading.beacon.find(kRobotRadio) != std::string::npos) return;
      reading.transmit_dbm = neighbor.at("my_txpw_actual_dBm").number();
      reading.receive_dbm = neighbor.at("received_signal_power_dBm").numbers();
      readings_.push_back(reading);
    });
  });
}

void Gatherer::add_truth(const std::vector<std::string>& source, const ros1::Value& message,
                         std::int64_t recorded_ns) {
  auto truth =
      std::find_if(truths_.begin(), truths_.end(), [&](const Truth& t) { return t.source == source; });
  if (truth == truths_.end()) truth = truths_.insert(truths_.end(), Truth{source, {}});
  if (const auto pose = pose_of_message(message)) {
    truth->poses.emplace_back(stamp_of(message, recorded_ns), *pose);
  } else {
    problems_.add_altered("true pose unusable", source.front());
  }
}

void Gatherer::use_stamps(const parts::Stamps& stamps) {
  for (auto& [key, seen] : graph_.nodes) {
    const auto stamp = stamps.find(key);
    if (seen.has_stamp || stamp == stamps.end()) continue;
    seen.stamp_ns = stamp->second;
    seen.has_stamp = true;
  }
}

}  // namespace loopwise::lamp
