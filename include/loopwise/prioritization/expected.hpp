// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/features/scan_signature.hpp>
#include <loopwise/prioritization/acceptance.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>
#include <loopwise/prioritization/prioritizer.hpp>

namespace loopwise {

/// Options of the draw by expected gain.
struct ExpectedOptions {
  double place_m = 10.0;
  double spread = 0.5;
  double gain_exponent = 0.5;
  bool use_overlap = true;
  bool use_places = true;
  bool use_right = true;
  std::int64_t probes = 32;
  double max_wait_s = 600.0;
  std::string verified_weights;
  std::string right_weights;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("place_m", self.place_m, above(0.0),
          "Path that counts as one place, m: candidates between the same two places are one group.");
    field("spread", self.spread, at_least(0.0),
          "Candidates are drawn with odds value^(1/spread); 0: the most valuable always first.");
    field("gain_exponent", self.gain_exponent, between(0.0, 1.0),
          "Of the gain in the value; 0: by the chance alone.");
    field(
        "use_overlap", self.use_overlap, any_value(),
        "The chance depends on the overlap that the scans will have by the estimate, not on distance alone.");
    field("use_places", self.use_places, any_value(),
          "The chance follows what came of candidates between the same two places.");
    field("use_right", self.use_right, any_value(),
          "Closures that robust optimisation leaves out count against their two places.");
    field("probes", self.probes, between(8, 1024),
          "Random probes of the gain; the error is about sqrt(2 / probes).");
    field("max_wait_s", self.max_wait_s, at_least(0.0),
          "Candidates to nodes that the graph does not have are given up after this, s; 0: never.");
    field("verified_weights", self.verified_weights, any_value(),
          "Prior of the chance that a candidate is verified: six numbers by commas, as `study acceptance` "
          "fits them; empty: the shipped ones.");
    field("right_weights", self.right_weights, any_value(),
          "Prior of the chance that a verified closure is kept, likewise.");
  }
};

/// Draws candidates at random, with odds that rise with their expected value. The value combines three
/// factors: the probability that the closure is verified, the probability that robust optimisation keeps it,
/// and the reduction of the graph's uncertainty. Candidates between the same two places form a group. A
/// closure that is expected from one member lowers the value of the others. See docs/prioritization.md.
class LOOPWISE_EXPORT ExpectedPrioritizer final : public Prioritizer {
 public:
  /// Makes the signature of a scan. An empty signature means that the scan is missing.
  using Signature = std::function<ScanSignature(const KeyedScan&)>;

  /// \param options of the draw
  /// \param closures the expected closure of a successful candidate
  /// \param robots whose nodes the candidates join
  /// \param signature of a scan; may be empty: then the probability depends on the distance
  /// \param seed of the draw
  /// \param name name in tables: "expected", or "likely" without the gain
  /// \throws OptionError
  ExpectedPrioritizer(const ExpectedOptions& options, const ClosureModelOptions& closures, Robots robots,
                      Signature signature, std::uint64_t seed, std::string_view name = "expected");
  ~ExpectedPrioritizer() override;

  [[nodiscard]] std::string_view name() const override;
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override;
  void on_graph(const PoseGraph& graph) override;
  void on_scan(const KeyedScan& scan) override;
  void on_result(const RegistrationResult& result) override;
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override;
  [[nodiscard]] std::vector<Refusal> give_up(double now_s) override;
  [[nodiscard]] std::size_t size() const override;

  [[nodiscard]] const Calibration* calibration() const override;

  /// The learned probability that a candidate is verified.
  [[nodiscard]] const AcceptanceModel& acceptance() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
