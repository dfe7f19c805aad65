// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <functional>
#include <string_view>
#include <unordered_map>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/prioritization/ranked_candidates.hpp>

namespace loopwise {

/// Form of the observability score.
enum class ObservabilityVariant {
  kPaper,  ///< λ_min of the 6×6 matrix, divided by the largest so far of all robots; the sum of both is
           ///< tested.
  kLamp,   ///< λ_min of Σ n nᵀ / N, divided by the largest so far of that robot; each score is tested.
};
[[nodiscard]] inline EnumNames<ObservabilityVariant> enum_names(ObservabilityVariant) {
  return {{ObservabilityVariant::kPaper, "paper"}, {ObservabilityVariant::kLamp, "lamp"}};
}

/// The score, and the bound below which candidates are refused.
struct ObservabilityPriorityOptions {
  /// Score: paper is the smallest eigenvalue over rotation and translation, lamp that of the normals alone,
  /// normalised for each robot.
  ObservabilityVariant variant = ObservabilityVariant::kPaper;
  /// Variant paper: candidates are refused if the sum of the scores at both ends is less than this.
  double min_sum = 0.1;
  /// Variant lamp: candidates are refused if the score at either end is less than this.
  double min_score = 0.2;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("variant", self.variant, any_value());
    field("min_sum", self.min_sum, between(0.0, 2.0));
    field("min_score", self.min_score, between(0.0, 1.0));
  }
};

/// Computes candidates between well-constrained scans first (paper §III-C). A scan's score is fixed on
/// arrival: its smallest eigenvalue divided by the largest so far, itself included, so that the first scan
/// has 1.
class LOOPWISE_EXPORT ObservabilityPrioritizer final : public Prioritizer {
 public:
  /// Smallest eigenvalue of a scan's observability matrix for the variant; >= 0.
  using Eigenvalue = std::function<double(const KeyedScan&)>;

  /// \throws OptionError; InputError if `eigenvalue` is empty.
  ObservabilityPrioritizer(const ObservabilityPriorityOptions& options, Robots robots, Eigenvalue eigenvalue);

  [[nodiscard]] std::string_view name() const override { return "obs"; }
  /// An end of a candidate whose scan was never announced has the score 0.
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override;
  void remove(const std::vector<CandidateId>& ids) override { ranked_.erase(ids); }
  void on_scan(const KeyedScan& scan) override;
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override { return ranked_.take(count); }
  [[nodiscard]] std::size_t size() const override { return ranked_.size(); }

  /// Score of a node's scan, in [0, 1]; 0 if it was never announced.
  [[nodiscard]] double score(Key key) const;

 private:
  ObservabilityPriorityOptions options_;
  Robots robots_;
  Eigenvalue eigenvalue_;
  std::unordered_map<std::size_t, double> largest_;  // by robot (lamp) or under 0 (paper)
  std::unordered_map<Key, double> scores_;
  RankedCandidates ranked_;
};

}  // namespace loopwise
