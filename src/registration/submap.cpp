// SPDX-License-Identifier: BSD-3-Clause
#include "submap.hpp"

#include <exception>

#include <loopwise/core/error.hpp>

namespace loopwise {

std::optional<Submap> Submap::load(FeatureCache& cache, const std::vector<SubmapMember>& members,
                                   std::size_t enough_points, RegistrationResult& result) {
  Submap submap;
  const auto missing = [&](Key key, const std::string& why) {
    result.reason = RejectionReason::kMissingScan;
    result.message = "scan " + key_name(key) + ": " + why;
    return std::nullopt;
  };
  if (members.empty()) return missing(result.candidate.from, "the task names no scan");
  std::size_t points = 0;
  for (const SubmapMember& member : members) {
    if (enough_points > 0 && points >= enough_points) break;
    Part part{member.key, member.T_center_member, nullptr};
    const bool neighbour = !submap.parts_.empty();
    try {
      part.features = cache.get(member.key);
    } catch (const Error& error) {  // the reader of the scans counts the error
      if (!neighbour) return missing(member.key, error.what());
    }
    if (!part.features) {
      if (!neighbour) return missing(member.key, "is missing");
      submap.incomplete_ = true;
      continue;
    }
    points += part.features->cloud.size();
    submap.parts_.push_back(std::move(part));
  }
  if (submap.parts_.size() == 1 && submap.parts_.front().T_center_part.matrix().isIdentity(0.0))
    return submap;

  auto all = std::make_shared<Union>();
  all->cloud.points.reserve(points);
  all->cloud.normals.reserve(points);
  for (const Part& part : submap.parts_) {
    const Eigen::Matrix3f R = part.T_center_part.linear().cast<float>();
    const Eigen::Vector3f t = part.T_center_part.translation().cast<float>();
    const PointCloud& cloud = part.features->cloud;
    for (const Eigen::Vector3f& p : cloud.points) all->cloud.points.push_back(R * p + t);
    for (const Eigen::Vector3f& n : cloud.normals) all->cloud.normals.push_back(R * n);
  }
  all->tree = KdTree(all->cloud.points);
  submap.union_ = std::move(all);
  return submap;
}

}  // namespace loopwise
