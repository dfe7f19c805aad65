// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/acceptance_fit.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <unordered_map>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/engine/scan_insight.hpp>
#include <loopwise/features/scan_signature.hpp>
#include <loopwise/prioritization/baselines.hpp>

#include "../core/constants.hpp"

namespace loopwise {
namespace {

/// A fit to many samples needs no prior, except for terms that no sample has.
constexpr double kFitStrength = 1.0;

using Evidence = std::map<std::pair<Key, Key>, CandidateEvidence>;

/// Random order that records the evidence of each candidate that it hands out.
class RecordingPrioritizer final : public Prioritizer {
 public:
  RecordingPrioritizer(std::uint64_t seed, ScanInsight scans, std::shared_ptr<Evidence> evidence)
      : random_(seed), scans_(std::move(scans)), evidence_(std::move(evidence)) {}

  [[nodiscard]] std::string_view name() const override { return random_.name(); }
  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) override {
    return random_.add(candidates);
  }
  void remove(const std::vector<CandidateId>& ids) override { random_.remove(ids); }
  void on_graph(const PoseGraph& graph) override {
    for (const Node& node : graph.nodes()) poses_[node.key] = node.pose;
  }
  void on_scan(const KeyedScan& scan) override { signatures_[scan.key] = scans_.signature(scan); }
  [[nodiscard]] std::vector<LoopCandidate> take(std::size_t count) override {
    std::vector<LoopCandidate> taken = random_.take(count);
    for (const LoopCandidate& candidate : taken)
      (*evidence_)[{candidate.from, candidate.to}] = evidence_of(candidate);
    return taken;
  }
  [[nodiscard]] std::size_t size() const override { return random_.size(); }

 private:
  [[nodiscard]] CandidateEvidence evidence_of(const LoopCandidate& candidate) const {
    CandidateEvidence evidence;
    evidence.from_outside = candidate.source != CandidateSource::kProximity;
    const auto from = poses_.find(candidate.from), to = poses_.find(candidate.to);
    if (from == poses_.end() || to == poses_.end()) return evidence;
    const Eigen::Isometry3d T_from_to = from->second.inverse() * to->second;
    evidence.distance_m = T_from_to.translation().norm();
    const auto a = signatures_.find(candidate.from), b = signatures_.find(candidate.to);
    if (a != signatures_.end() && b != signatures_.end() && !a->second.empty() && !b->second.empty()) {
      evidence.overlap = predicted_overlap(a->second, b->second, T_from_to);
    }
    return evidence;
  }

  RandomPrioritizer random_;
  ScanInsight scans_;
  std::shared_ptr<Evidence> evidence_;
  std::unordered_map<Key, Eigen::Isometry3d> poses_;
  std::unordered_map<Key, ScanSignature> signatures_;
};

/// The samples to which an outcome applies, with their outcomes.
std::vector<std::pair<CandidateEvidence, bool>> labelled(const AcceptanceSamples& mission,
                                                         AcceptanceOutcome outcome) {
  std::vector<std::pair<CandidateEvidence, bool>> out;
  for (const AcceptanceSample& sample : mission.samples) {
    if (outcome == AcceptanceOutcome::kVerified) {
      out.emplace_back(sample.evidence, sample.verified);
    } else if (sample.verified) {
      out.emplace_back(sample.evidence, sample.right);
    }
  }
  return out;
}

using Labelled = std::vector<std::pair<CandidateEvidence, bool>>;

bool has_both_outcomes(const Labelled& samples) {
  const auto came = [](const auto& sample) { return sample.second; };
  return std::any_of(samples.begin(), samples.end(), came) &&
         !std::all_of(samples.begin(), samples.end(), came);
}

AcceptanceModel fitted(const std::vector<std::pair<CandidateEvidence, bool>>& samples) {
  AcceptanceModel model(AcceptanceModel::Terms{}, kFitStrength);
  model.fit(samples);
  return model;
}

/// The score if the other missions allow no fit.
AcceptanceScore unscored(const AcceptanceSamples& mission, AcceptanceOutcome outcome) {
  AcceptanceScore score;
  score.mission = mission.mission;
  score.auc = score.brier = score.auc_by_distance = kNan;
  for (const auto& [evidence, came] : labelled(mission, outcome)) {
    ++score.count;
    score.positive += came ? 1 : 0;
  }
  return score;
}

AcceptanceScore score_of(const AcceptanceModel& model, const AcceptanceSamples& mission,
                         AcceptanceOutcome outcome, Calibration& all) {
  AcceptanceScore score = unscored(mission, outcome);
  Calibration own;
  std::vector<double> chances, nearness;
  std::vector<bool> positive;
  for (const auto& [evidence, came] : labelled(mission, outcome)) {
    const double chance = model.probability(evidence);
    own.add(chance, came);
    all.add(chance, came);
    chances.push_back(chance);
    nearness.push_back(-evidence.distance_m);
    positive.push_back(came);
  }
  score.auc = roc_auc(chances, positive);
  score.auc_by_distance = roc_auc(nearness, positive);
  score.brier = own.brier();
  return score;
}

}  // namespace

AcceptanceSamples collect_acceptance(const Mission& mission, const ReplayOptions& options,
                                     const Registration& registration, ThreadPool& threads,
                                     const ReplayHooks& hooks) {
  const auto evidence = std::make_shared<Evidence>();
  const ScanInsight scans = scan_insight(*registration.features, ObservabilityVariant::kPaper);
  const MissionReplay replay(mission, options, registration, [&] {
    std::vector<std::unique_ptr<Prioritizer>> one;
    one.push_back(std::make_unique<RecordingPrioritizer>(options.engine.seed, scans, evidence));
    return one;
  });
  const ReplayResult result = replay.run(threads, hooks);
  AcceptanceSamples out;
  out.mission = mission.name;
  for (const ComputedCandidate& computed : result.computed) {
    const LoopCandidate& candidate = computed.result.candidate;
    const auto known = evidence->find({candidate.from, candidate.to});
    if (known == evidence->end()) continue;  // a failed task may name another pair
    const bool verified = computed.result.verified();
    out.samples.push_back({known->second, verified, verified && computed.weight >= 0.5});
  }
  return out;
}

AcceptanceFit fit_acceptance(const std::vector<AcceptanceSamples>& missions, AcceptanceOutcome outcome) {
  std::vector<std::pair<CandidateEvidence, bool>> all;
  for (const AcceptanceSamples& mission : missions) {
    const auto own = labelled(mission, outcome);
    all.insert(all.end(), own.begin(), own.end());
  }
  if (!has_both_outcomes(all)) {
    throw InputError(
        std::string(outcome == AcceptanceOutcome::kVerified ? "candidates" : "verified closures") +
        " of these missions all came to the same: nothing can be fitted to " + std::to_string(all.size()) +
        " of them; give more or longer missions");
  }
  AcceptanceFit fit;
  fit.weights = fitted(all).weights();
  if (missions.size() < 2) return fit;
  for (std::size_t left_out = 0; left_out < missions.size(); ++left_out) {
    std::vector<std::pair<CandidateEvidence, bool>> others;
    for (std::size_t m = 0; m < missions.size(); ++m) {
      if (m == left_out) continue;
      const auto own = labelled(missions[m], outcome);
      others.insert(others.end(), own.begin(), own.end());
    }
    if (has_both_outcomes(others)) {
      fit.scores.push_back(score_of(fitted(others), missions[left_out], outcome, fit.calibration));
    } else {
      fit.scores.push_back(unscored(missions[left_out], outcome));
    }
  }
  return fit;
}

double roc_auc(const std::vector<double>& scores, const std::vector<bool>& positive) {
  if (scores.size() != positive.size()) throw InputError("roc_auc: as many scores as outcomes are needed");
  if (std::any_of(scores.begin(), scores.end(), [](double score) { return std::isnan(score); }))
    throw InputError("roc_auc: a score is not a number");
  std::vector<std::size_t> order(scores.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return scores[a] < scores[b]; });
  // Mann–Whitney: ranks of the positive samples; equal scores get their mean rank.
  double rank_sum = 0.0, count = 0.0;
  for (std::size_t begin = 0; begin < order.size();) {
    std::size_t end = begin;
    while (end < order.size() && scores[order[end]] == scores[order[begin]]) ++end;
    const double rank = 0.5 * static_cast<double>(begin + 1 + end);
    for (std::size_t k = begin; k < end; ++k) {
      if (!positive[order[k]]) continue;
      rank_sum += rank;
      count += 1.0;
    }
    begin = end;
  }
  const double others = static_cast<double>(scores.size()) - count;
  if (count == 0.0 || others == 0.0) return kNan;
  return (rank_sum - 0.5 * count * (count + 1.0)) / (count * others);
}

}  // namespace loopwise
