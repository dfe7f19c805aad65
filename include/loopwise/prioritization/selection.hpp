// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/prioritization/graph_objective.hpp>

namespace loopwise {

/// A chosen set of candidates and the effort of the choice.
struct Selection {
  std::vector<std::size_t> set;   ///< Most valuable first, if the selector orders them.
  double value = 0.0;             ///< The objective of the set.
  std::uint64_t evaluations = 0;  ///< Evaluations of the objective or of its changes.
  std::uint64_t accepted = 0;     ///< Swaps made by annealing.
  bool stopped = false;           ///< A stop was requested before the end; the set is full nevertheless.
};

/// Greedy choice.
struct GreedyOptions {
  /// Re-evaluate only the candidate that was best before. The result is exact for submodular objectives
  /// (log_det) and slightly worse for the trace.
  bool lazy = false;
  /// Candidates that connect separate parts of the graph come first, up to this share of the set.
  double connecting_share = 0.5;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("lazy", self.lazy, any_value());
    field("connecting_share", self.connecting_share, between(0.0, 1.0));
  }
};

/// Repeatedly takes the candidate that lowers the objective most; connecting candidates first, spread over
/// their midpoints. Ties go to the lower number. Leaves the set in the objective. After a stop request the
/// last known gains decide the rest. `midpoints` has one for each candidate. \throws InputError on another
/// number of them.
[[nodiscard]] LOOPWISE_EXPORT Selection greedy(GraphObjective& objective,
                                               const std::vector<Eigen::Vector3d>& midpoints,
                                               std::size_t count, const GreedyOptions& options = {},
                                               const StopToken& stop = {});

/// Simulated annealing: temperatures and partners.
struct AnnealingOptions {
  /// First temperature, in units of the median change of random swaps.
  double temperature_max = 1.0;
  /// Last temperature, in units of the median change of random swaps.
  double temperature_min = 1e-4;
  /// Factor of the temperature at each step.
  double cooling = 0.995;
  /// Share of temperature_max at which annealing of a set that was already chosen begins. A higher
  /// temperature would undo the choice.
  double seeded_share = 0.01;
  /// Temperatures are in units of the objective, not of the median change of random swaps.
  bool absolute = false;
  /// Number of random swaps from which the median change is taken.
  std::int64_t scale_samples = 100;
  /// Minimum distance of partners, m. Closer partners count as this far, since the odds of a partner are 1 /
  /// distance.
  double distance_floor_m = 0.1;
  /// If there are more candidates outside of the set than this, the partner is chosen among this many, drawn
  /// at random.
  std::int64_t partners = 500;
  /// Maximum number of steps, far beyond the end of cooling. 0: no bound.
  std::int64_t max_steps = 50000;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("temperature_max", self.temperature_max, at_least(0.0));
    field("temperature_min", self.temperature_min, at_least(0.0));
    field("cooling", self.cooling, Bounds{0.0, 1.0, true});
    field("seeded_share", self.seeded_share, between(0.0, 1.0));
    field("absolute", self.absolute, any_value());
    field("scale_samples", self.scale_samples, at_least(1));
    field("distance_floor_m", self.distance_floor_m, above(0.0));
    field("partners", self.partners, at_least(1));
    field("max_steps", self.max_steps, at_least(0));
  }
};

/// Options by name: "default", or "lamp" (3, 1e-4, 0.995 absolute, as LAMP's parameters intend; LAMP draws
/// partners the same way). \throws OptionError naming the presets.
[[nodiscard]] LOOPWISE_EXPORT AnnealingOptions annealing_preset(std::string_view name);

/// The paper's Algorithm 1 in a resumable form: T = max(T_max·c^step, T_min); a member chosen uniformly
/// leaves, an outsider enters with odds inverse to the distance of their midpoints; the swap stands if it
/// lowers the objective or exp(−δ/T) > U(0, 1). Seeded: the same steps give the same set, for any division
/// into runs.
class LOOPWISE_EXPORT SimulatedAnnealing {
 public:
  /// Starts from `initial`, or from the farthest points of the midpoints if that is empty; `count` is capped
  /// at the number of candidates. The objective must outlive this object and not be changed by others
  /// meanwhile. \throws OptionError; InputError on another number of midpoints or of initial members.
  SimulatedAnnealing(GraphObjective& objective, std::vector<Eigen::Vector3d> midpoints, std::size_t count,
                     const AnnealingOptions& options, std::uint64_t seed,
                     const std::vector<std::size_t>& initial = {});

  /// Continues until this number of further evaluations is used or a stop is requested. The first run begins
  /// with the evaluations for the scale of the temperature.
  void run(std::uint64_t evaluations, const StopToken& stop = {});

  /// The best set found, evaluated from scratch; never above the start. Leaves that set in the objective
  /// until the next run.
  [[nodiscard]] Selection best();

  /// Swaps tried so far.
  [[nodiscard]] std::uint64_t steps() const { return steps_; }
  /// Swaps accepted so far.
  [[nodiscard]] std::uint64_t accepted() const { return accepted_; }
  /// Evaluations used so far, including those for the scale.
  [[nodiscard]] std::uint64_t evaluations() const { return evaluations_; }
  /// The objective of the initial set.
  [[nodiscard]] double start_value() const { return start_value_; }

 private:
  [[nodiscard]] std::size_t choose_partner(std::size_t out);
  void find_scale(std::uint64_t& budget, const StopToken& stop);

  GraphObjective& objective_;
  std::vector<Eigen::Vector3d> midpoints_;
  AnnealingOptions options_;
  Rng rng_;
  std::vector<std::size_t> outside_;
  std::vector<std::size_t> current_, start_, best_;
  double value_ = 0.0, start_value_ = 0.0, best_value_ = 0.0;
  std::vector<double> scale_samples_;
  double scale_ = 0.0;
  bool scaled_ = false;
  double first_temperature_ = 0.0;
  bool parked_ = false;  // best() left its set in the objective
  std::uint64_t steps_ = 0, accepted_ = 0, evaluations_ = 0;
  bool stopped_ = false;
  std::vector<std::size_t> drawn_;
  std::vector<double> odds_;
};

/// Maximal spatial spread: begins with the point farthest from the centroid, then repeatedly takes the point
/// farthest from the chosen ones; ties go to the lower number. O(count · points).
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::size_t> farthest_points(
    const std::vector<Eigen::Vector3d>& points, std::size_t count);

/// The candidates whose two nodes have the largest uncertainty, by the sum of the traces of their
/// translational covariances. `covariances` are one per node of the graph, as in Marginals.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::size_t> largest_covariance(
    const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
    const std::vector<Matrix6d>& covariances, std::size_t count);

}  // namespace loopwise
