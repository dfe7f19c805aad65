// SPDX-License-Identifier: BSD-3-Clause
#include "confirmed_closures.hpp"

#include <algorithm>
#include <cstdint>
#include <map>
#include <tuple>
#include <utility>

#include <Eigen/Dense>

#include <loopwise/core/disjoint_sets.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/optimization/gnc.hpp>

#include "innovation.hpp"

namespace loopwise::detail {
namespace {

/// Two closures are near each other if their ends are at most this many steps of odometry apart, summed over
/// both ends.
constexpr std::uint32_t kNearSteps = 12;
/// Bound on the neighbours that are tested for a closure, nearest first.
constexpr std::size_t kMostTried = 12;
/// Largest difference of the keys of two nodes that are hardly apart.
constexpr Key kHardlyApart = 3;
/// Bound on the closures that are examined in each direction: many closures may end at one place.
constexpr std::size_t kMostSeen = 2000;
/// Fewest closures with neighbours that show the noise.
constexpr std::size_t kFewestPairs = 20;
/// Smaller d² are not noise but copies, of one measurement or of the odometry.
constexpr double kLeastInnovation = 1e-7;
/// A large group has a tenth of the closures of the largest one, if that one has a tenth of all.
constexpr std::size_t kSmallestShare = 10;

Key keys_apart(const Edge& edge) {
  return edge.from < edge.to ? edge.to - edge.from : edge.from - edge.to;
}

/// Keys of different robots are far apart, unless they are plain numbers.
bool may_continue_odometry(const Edge& edge) {
  return keys_apart(edge) <= kHardlyApart;
}

/// The longest step of odometry, and the largest turn in one.
struct LongestStep {
  double m = 0.0, rad = 0.0;

  explicit LongestStep(const PoseGraph& graph) {
    for (const Edge& edge : graph.edges()) {
      if (!known_inlier(edge)) continue;
      m = std::max(m, edge.T_from_to.translation().norm());
      rad = std::max(rad, se3::rotation_angle(edge.T_from_to));
    }
  }
  /// Whether the closure is as short as the steps of odometry between its keys would be.
  [[nodiscard]] bool allows(const Edge& closure) const {
    const auto steps = static_cast<double>(keys_apart(closure));
    return closure.T_from_to.translation().norm() <= steps * m &&
           se3::rotation_angle(closure.T_from_to) <= steps * rad;
  }
};

/// Whether Ω determines most directions.
bool is_informative(const Matrix6d& information) {
  constexpr int kFewestDirections = 4;
  const Vector6d values = Eigen::SelfAdjointEigenSolver<Matrix6d>(information).eigenvalues();
  return (values.array() > 1e-9 * values[5]).count() >= kFewestDirections;
}

std::uint32_t steps(std::uint32_t a, std::uint32_t b) {
  return a < b ? b - a : a - b;
}

/// A closure as seen from one of its ends.
struct Seen {
  std::uint32_t root, other_root, place, other_place, edge;
  bool reversed;
};

class Confirmation {
 public:
  Confirmation(const PoseGraph& graph, const OdometryForest& forest, double c2)
      : graph_(graph), forest_(forest), c2_(c2), confirmed_(graph.edges().size(), 0) {
    for (std::size_t e = 0; e < graph.edges().size(); ++e) {
      if (known_inlier(graph.edges()[e])) continue;
      for (const bool reversed : {false, true}) seen_.push_back(seen(e, reversed));
    }
    std::sort(seen_.begin(), seen_.end(), [](const Seen& a, const Seen& b) {
      return std::tie(a.root, a.other_root, a.place, a.other_place, a.edge, a.reversed) <
             std::tie(b.root, b.other_root, b.place, b.other_place, b.edge, b.reversed);
    });
  }

  std::vector<char> find(const std::vector<char>& wanted) {
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      const std::uint32_t e = seen_[i].edge;
      if (!seen_[i].reversed && wanted[e] != 0 && confirmed_[e] == 0) look_around(i);
    }
    for (std::size_t e = 0; e < confirmed_.size(); ++e) {
      if (wanted[e] == 0) confirmed_[e] = 0;
    }
    return std::move(confirmed_);
  }

  /// The size of the group of each wanted closure, by edge; 0 for the others.
  std::vector<std::size_t> group_sizes(const std::vector<char>& wanted) {
    DisjointSets groups(wanted.size());
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      const std::uint32_t e = seen_[i].edge;
      if (seen_[i].reversed || wanted[e] == 0) continue;
      find_near(i, &wanted);
      for (const auto& [distance, other] : near_) {
        if (groups.root(e) != groups.root(other->edge) && agree(e, *other)) groups.join(e, other->edge);
      }
    }
    std::vector<std::size_t> of_root(wanted.size()), out(wanted.size());
    for (std::size_t e = 0; e < wanted.size(); ++e) of_root[groups.root(e)] += wanted[e] != 0 ? 1 : 0;
    for (std::size_t e = 0; e < wanted.size(); ++e) out[e] = wanted[e] != 0 ? of_root[groups.root(e)] : 0;
    return out;
  }

  /// in_large_groups()
  std::vector<char> large_groups(const std::vector<char>& wanted) {
    const std::vector<std::size_t> size = group_sizes(wanted);
    std::vector<std::size_t> own;
    for (const std::size_t n : size) {
      if (n > 0) own.push_back(n);
    }
    std::vector<char> out(wanted.size());
    if (own.empty()) return out;
    const std::size_t smallest = std::max<std::size_t>(2, smallest_large_group(std::move(own)));
    for (std::size_t e = 0; e < wanted.size(); ++e) out[e] = size[e] >= smallest ? 1 : 0;
    return out;
  }

  /// d² of every closure with respect to the nearest one, unless it has none near it.
  std::vector<double> innovations_across_nearest() {
    std::vector<double> out;
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      if (seen_[i].reversed || !covariance_of(graph_.edges()[seen_[i].edge].information)) continue;
      find_near(i);
      if (near_.empty()) continue;
      const double d2 = innovation_across(seen_[i].edge, *near_.front().second);
      if (d2 >= kLeastInnovation) out.push_back(d2);
    }
    return out;
  }

 private:
  [[nodiscard]] Seen seen(std::size_t e, bool reversed) const {
    auto [from, to] = graph_.ends(e);
    if (reversed) std::swap(from, to);
    return {forest_.root(from),
            forest_.root(to),
            forest_.place(from),
            forest_.place(to),
            static_cast<std::uint32_t>(e),
            reversed};
  }

  /// The size from which a group is large. \param sizes of the group of each closure, not empty
  static std::size_t smallest_large_group(std::vector<std::size_t> sizes) {
    const std::size_t largest = *std::max_element(sizes.begin(), sizes.end());
    if (kSmallestShare * largest >= sizes.size()) return (largest + kSmallestShare - 1) / kSmallestShare;
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    return *middle;
  }

  void look_around(std::size_t i) {
    const Seen& own = seen_[i];
    find_near(i);
    for (const auto& [distance, other] : near_) {
      if (!agree(own.edge, *other)) continue;
      confirmed_[own.edge] = confirmed_[other->edge] = 1;
      return;
    }
  }

  /// Finds the closures near this one, nearest first: all, or only wanted ones (by edge).
  void find_near(std::size_t i, const std::vector<char>* wanted = nullptr) {
    const Seen& own = seen_[i];
    near_.clear();
    std::size_t seen = 0;
    const auto consider = [&](const Seen& other) {
      if (++seen > kMostSeen || other.root != own.root || other.other_root != own.other_root) return false;
      const std::uint32_t at_this_end = steps(other.place, own.place);
      if (at_this_end > kNearSteps) return false;
      const std::uint32_t all = at_this_end + steps(other.other_place, own.other_place);
      if (all <= kNearSteps && other.edge != own.edge && (wanted == nullptr || (*wanted)[other.edge] != 0))
        near_.emplace_back(all, &other);
      return true;
    };
    for (std::size_t k = i + 1; k < seen_.size() && consider(seen_[k]);) ++k;
    seen = 0;
    for (std::size_t k = i; k > 0 && consider(seen_[k - 1]);) --k;
    std::sort(near_.begin(), near_.end(), [](const auto& a, const auto& b) {
      return std::tie(a.first, a.second->edge) < std::tie(b.first, b.second->edge);
    });
    if (near_.size() > kMostTried) near_.resize(kMostTried);
  }

  [[nodiscard]] bool agree(std::size_t e, const Seen& other) const {
    const double d2 = innovation_across(e, other);
    return d2 >= 0.0 && d2 <= c2_;
  }

  /// d² of this closure's measurement by the path A B C across the other closure; NaN if that one has no
  /// covariance, or the information of this one leaves most directions open.
  [[nodiscard]] double innovation_across(std::size_t e, const Seen& other) const {
    const auto [from, to] = graph_.ends(e);
    const Edge& edge = graph_.edges()[e];
    const Edge& across = graph_.edges()[other.edge];
    auto [near_from, near_to] = graph_.ends(other.edge);
    auto others = covariance_of(across.information);
    if (!others || (!covariance_of(edge.information) && !is_informative(edge.information))) return kNotKnown;
    Eigen::Isometry3d B = across.T_from_to;
    if (other.reversed) {
      std::swap(near_from, near_to);
      others = on_the_right(*others, B.inverse());
      B = B.inverse();
    }
    const auto there = forest_.between(from, near_from), on = forest_.between(near_to, to);
    if (!there || !on) return kNotKnown;
    const Eigen::Isometry3d A = forest_.pose(from).inverse() * forest_.pose(near_from);
    const Eigen::Isometry3d C = forest_.pose(near_to).inverse() * forest_.pose(to);
    const Matrix6d prediction = on_the_right(*there, forest_.pose(near_from) * B * C) +
                                on_the_right(*others, C) + on_the_right(*on, forest_.pose(to));
    return squared_innovation(edge.information, prediction, se3::log(edge.T_from_to.inverse() * A * B * C));
  }

  const PoseGraph& graph_;
  const OdometryForest& forest_;
  const double c2_;
  std::vector<char> confirmed_;  // by edge
  std::vector<Seen> seen_;
  std::vector<std::pair<std::uint32_t, const Seen*>> near_;
};

}  // namespace

std::vector<char> confirmed_closures(const PoseGraph& graph, const OdometryForest& forest,
                                     const std::vector<char>& wanted, double c2) {
  return Confirmation(graph, forest, c2).find(wanted);
}

OdometryForest joined_forest(const PoseGraph& graph, double c2) {
  OdometryForest forest(graph);
  const std::vector<char> known = known_inliers(graph);
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::size_t> between_trees;
  const auto trees_of = [&](std::size_t e) {
    const auto [from, to] = graph.ends(e);
    const std::uint32_t a = forest.root(from), b = forest.root(to);
    return std::make_pair(std::min(a, b), std::max(a, b));
  };
  const LongestStep longest(graph);
  std::vector<char> wanted(known.size());
  bool any = false;
  for (std::size_t e = 0; e < wanted.size(); ++e) {
    const auto [a, b] = trees_of(e);
    if (known[e] != 0 || a == b) continue;
    ++between_trees[{a, b}];
    const Edge& edge = graph.edges()[e];
    wanted[e] = may_continue_odometry(edge) && longest.allows(edge) ? 1 : 0;
    any = any || wanted[e] != 0;
  }
  if (!any) return forest;
  const std::vector<char> confirmed = confirmed_closures(graph, forest, wanted, c2);
  std::vector<std::size_t> joints;
  for (std::size_t e = 0; e < wanted.size(); ++e) {
    // Others between the same trees that do not confirm it speak against it.
    const bool is_joint = wanted[e] != 0 && (confirmed[e] != 0 || between_trees.at(trees_of(e)) == 1);
    if (is_joint && covariance_of(graph.edges()[e].information)) joints.push_back(e);
  }
  std::stable_sort(joints.begin(), joints.end(), [&](std::size_t a, std::size_t b) {
    return std::make_tuple(-confirmed[a], keys_apart(graph.edges()[a])) <
           std::make_tuple(-confirmed[b], keys_apart(graph.edges()[b]));
  });
  DisjointSets trees(graph.nodes().size());
  // Trees with priors are joined by these.
  for (const PriorFactor& prior : graph.priors()) {
    trees.join(forest.root(graph.index_of(prior.key)), forest.root(graph.index_of(graph.priors()[0].key)));
  }
  std::vector<char> in_tree = known;
  for (const std::size_t e : joints) {
    const auto [a, b] = trees_of(e);
    if (trees.root(a) == trees.root(b)) continue;
    trees.join(a, b);
    in_tree[e] = 1;
  }
  return OdometryForest(graph, in_tree);
}

std::vector<char> in_large_groups(const PoseGraph& graph, const OdometryForest& forest,
                                  const std::vector<char>& wanted, double c2) {
  if (wanted.empty()) return {};
  return Confirmation(graph, forest, c2).large_groups(wanted);
}

std::vector<std::size_t> group_sizes(const PoseGraph& graph, const OdometryForest& forest,
                                     const std::vector<char>& wanted, double c2) {
  if (wanted.empty()) return {};
  return Confirmation(graph, forest, c2).group_sizes(wanted);
}

std::vector<double> innovations_of_neighbours(const PoseGraph& graph, const OdometryForest& forest) {
  std::vector<double> d2 = Confirmation(graph, forest, 0.0).innovations_across_nearest();
  if (d2.size() < kFewestPairs) d2.clear();
  return d2;
}

double noise_of_neighbours(std::vector<double> d2, int degrees_of_freedom) {
  const auto decile = d2.begin() + static_cast<std::ptrdiff_t>(d2.size() / 10);
  std::nth_element(d2.begin(), decile, d2.end());
  return *decile / chi_squared_quantile(0.1, degrees_of_freedom);
}

}  // namespace loopwise::detail
