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
  /// Length of the path that counts as one place, m. Candidates between the same two places form one group.
  double place_m = 10.0;
  /// Candidates are drawn with odds value^(1/spread). 0: always the most valuable first.
  double spread = 0.5;
  /// Exponent of the gain in the value. 0: only the probability counts.
  double gain_exponent = 0.5;
  /// The probability depends on the overlap of the scans by the estimate. Off: it depends on the distance
  /// alone.
  bool use_overlap = true;
  /// The probability depends on the outcomes of candidates between the same two places.
  bool use_places = true;
  /// Closures that robust optimisation rejects lower the probability between their two places.
  bool use_right = true;
  /// Number of random probes of the gain. The relative error is about sqrt(2 / probes).
  std::int64_t probes = 32;
  /// Candidates are given up if the graph lacks their nodes for longer than this, s. 0: never.
  double max_wait_s = 600.0;
  /// Prior of the probability that a candidate is verified: six numbers, separated by commas, as
  /// `study acceptance` fits them. Empty: the built-in numbers.
  std::string verified_weights;
  /// Prior of the probability that a verified closure is kept, in the same form. Empty: the built-in numbers.
  std::string right_weights;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("place_m", self.place_m, above(0.0));
    field("spread", self.spread, at_least(0.0));
    field("gain_exponent", self.gain_exponent, between(0.0, 1.0));
    field("use_overlap", self.use_overlap, any_value());
    field("use_places", self.use_places, any_value());
    field("use_right", self.use_right, any_value());
    field("probes", self.probes, between(8, 1024));
    field("max_wait_s", self.max_wait_s, at_least(0.0));
    field("verified_weights", self.verified_weights, any_value());
    field("right_weights", self.right_weights, any_value());
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
