// SPDX-License-Identifier: BSD-3-Clause
#include "place_pairs.hpp"

#include <algorithm>

namespace loopwise::detail {

void Places::add_nodes(const PoseGraph& graph) {
  for (std::size_t node = place_.size(); node < graph.nodes().size(); ++node) {
    const Eigen::Vector3d position = graph.nodes()[node].pose.translation();
    const std::size_t robot = robots_.of(graph.nodes()[node].key);
    const auto [found, fresh] =
        ends_.try_emplace(robot, End{next_place_, static_cast<std::uint32_t>(node), position, 0.0});
    End& end = found->second;
    if (fresh) {
      ++next_place_;
    } else {
      end.length_m += (position - end.position).norm();
      if (end.length_m > place_m_) end = {next_place_++, end.node, position, 0.0};
    }
    end.position = position;
    place_.push_back(end.place);
    before_.push_back(end.node);
    robot_.push_back(robot);
    end.node = static_cast<std::uint32_t>(node);
  }
}

std::uint32_t PlacePairs::number_of(std::uint32_t a, std::uint32_t b) {
  const auto [low, high] = std::minmax(a, b);
  if (rows_.size() <= high) rows_.resize(high + 1);
  Row& row = rows_[high];
  const auto at = std::lower_bound(row.begin(), row.end(), std::pair(low, std::uint32_t{0}));
  if (at != row.end() && at->first == low) return at->second;
  row.insert(at, {low, size_});
  return size_++;
}

const std::uint32_t* PlacePairs::find(std::uint32_t a, std::uint32_t b) const {
  const auto [low, high] = std::minmax(a, b);
  if (rows_.size() <= high) return nullptr;
  const Row& row = rows_[high];
  const auto at = std::lower_bound(row.begin(), row.end(), std::pair(low, std::uint32_t{0}));
  return at != row.end() && at->first == low ? &at->second : nullptr;
}

}  // namespace loopwise::detail
