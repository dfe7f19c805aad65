// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/generation/candidate_generator.hpp>

namespace loopwise {

/// Selection of older nodes near a new one (paper §III-A). The radius grows with the possible drift: `rate_m
/// · |i_n − i_c|` for two nodes of one robot, `rate_m · i_n` between robots, where i counts a robot's own
/// nodes from 0 and n is the new node.
struct ProximityOptions {
  /// Search radius gained per node index, m.
  double rate_m = 0.2;
  /// The search radius is never less than this, m. A smaller radius_max_m overrides the default.
  double radius_min_m = 30.0;
  /// The search radius is never more than this, m. 0: no bound.
  double radius_max_m = 30.0;
  /// Two nodes of one robot are candidates only if their indices differ by at least this much.
  std::int64_t skip_recent = 10;
  /// Maximum number of candidates of each new node, nearest first. 0: no bound.
  std::int64_t n_closest = 0;
  /// Minimum distance along the path between nodes that get candidates, m. Nodes rotated by spacing_rad are
  /// exempt. 0: all nodes get candidates.
  double spacing_m = 1.0;
  /// A node also gets candidates if it is rotated by at least this angle against the last node of its robot
  /// that got candidates, rad.
  double spacing_rad = 0.5;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("rate_m", self.rate_m, at_least(0.0));
    field("radius_min_m", self.radius_min_m, at_least(0.0));
    field("radius_max_m", self.radius_max_m, at_least(0.0));
    field("skip_recent", self.skip_recent, at_least(0.0));
    field("n_closest", self.n_closest, at_least(0.0));
    field("spacing_m", self.spacing_m, at_least(0.0));
    field("spacing_rad", self.spacing_rad, at_least(0.0));
  }
};

/// \throws OptionError naming the field, also if a radius_min_m other than the default exceeds
/// a bounded radius_max_m.
LOOPWISE_EXPORT void validate_proximity(const ProximityOptions& options);

/// Options by name: "paper" (0.2 m per index without a bound: too many candidates on long missions),
/// "lamp_2022_01" (the same up to 30 m, 10 closest, skip 10), "lamp_base" (flat 30 m, skip 10; the default),
/// "lamp_robot" (5 to 80 m, skip 15, 3 closest). \throws OptionError naming the known presets.
[[nodiscard]] LOOPWISE_EXPORT ProximityOptions proximity_preset(std::string_view name);
/// The presets' names.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::string> proximity_preset_names();

/// Proposes older nodes within a radius of the current estimate, ordered by their arrival. Of adjacent nodes
/// on a path only some take part, see ProximityOptions::spacing_m: the others are redundant and constrained
/// by odometry. A hash grid holds the positions: the cost of a new node is proportional to the nodes near it;
/// a new estimate re-sorts them in O(n).
class LOOPWISE_EXPORT ProximityGenerator final : public CandidateGenerator {
 public:
  /// \throws OptionError
  ProximityGenerator(const ProximityOptions& options, Robots robots);

  [[nodiscard]] std::string_view name() const override { return "proximity"; }
  [[nodiscard]] std::vector<LoopCandidate> on_node(const PoseGraph& graph, Key key, double time_s) override;
  void on_graph(const PoseGraph& graph) override;
  /// Candidates of nodes whose pose changed since on_node(): their present neighbours, older or newer, with
  /// the radius for the index of the later node, and the closest of each. Nodes of the same robots that took
  /// no part do so if they have moved away from the others on the path.
  [[nodiscard]] std::vector<LoopCandidate> on_moved(const PoseGraph& graph, const std::vector<Key>& keys,
                                                    double time_s);

 private:
  struct Entry {
    Key key;
    std::size_t robot;
    std::uint64_t index;  ///< Among the robot's own nodes.
    Eigen::Vector3d position;
  };
  /// Whether a node is far enough from those before and after it on its robot's path that take part.
  [[nodiscard]] bool takes_part(const PoseGraph& graph, Key key) const;
  /// Adds a node that takes part from now on. \returns its candidates
  std::vector<LoopCandidate> add_participant(const PoseGraph& graph, Key key, double time_s);
  using Cell = Eigen::Vector3i;
  struct CellHash {
    std::size_t operator()(const Cell& cell) const;
  };

  [[nodiscard]] Cell cell_of(const Eigen::Vector3d& position) const;
  [[nodiscard]] double radius(const Entry& entry, const Entry& other) const;
  /// Candidates of `entry`, the one with the number `own`. `most` bounds the index that sets the radius.
  [[nodiscard]] std::vector<LoopCandidate> near(const Entry& entry, std::size_t own, std::uint64_t most,
                                                double time_s) const;
  void collect(const Entry& entry, std::size_t own, const std::vector<std::size_t>& numbers,
               std::vector<std::pair<double, std::size_t>>& found) const;

  ProximityOptions options_;
  Robots robots_;
  std::vector<std::uint64_t> highest_index_;            ///< By robot, of the nodes that arrived.
  std::vector<std::map<std::uint64_t, Key>> path_;      ///< By robot: nodes that take part, by index.
  std::vector<std::map<std::uint64_t, Key>> left_out_;  ///< The other ones.
  double cell_m_;
  std::vector<Entry> entries_;  ///< In order of arrival.
  std::unordered_map<Key, std::size_t> number_of_;
  std::unordered_map<Cell, std::vector<std::size_t>, CellHash> grid_;
};

}  // namespace loopwise
