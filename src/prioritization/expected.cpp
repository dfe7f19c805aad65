// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/expected.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/core/thread_pool.hpp>

#include "closure_factor.hpp"
#include "place_pairs.hpp"
#include "relative_sketch.hpp"

namespace loopwise {
namespace {

using detail::GroupMember;

constexpr double kMoved_m = 0.15,
                 kMoved_rad = 0.02;  // change of a group's guess after which its overlaps are predicted again
constexpr std::size_t kMaxExamined = 4;   // members whose overlap represents a group
constexpr std::size_t kMostMembers = 64;  // bound on the members among which the best is chosen
constexpr double kPlaceStrength = 2.0;    // weight of the chance by evidence, in results
constexpr double kRefreshed = 1.05;       // growth of the graph after which gains are sketched again
constexpr double kMostChance = 0.98;
constexpr std::size_t kGroupsPerTask = 256;   // groups per task of the pool
constexpr std::size_t kRefreshBudget = 8192;  // bound on groups with an old value that one take() updates

struct KeyPairHash {
  std::size_t operator()(const std::pair<Key, Key>& pair) const {
    return static_cast<std::size_t>(combine_seeds(pair.first, pair.second));
  }
};

/// Standard Gumbel noise. The largest of several log-weights plus this noise is a sample with odds by weight.
double gumbel(std::uint64_t bits) {
  const double uniform = (static_cast<double>(bits >> 12) + 0.5) * 0x1.0p-52;
  return -std::log(-std::log(uniform));
}

AcceptanceModel prior(const std::string& given, const char* option, const AcceptanceModel::Terms& shipped) {
  return AcceptanceModel(given.empty() ? shipped : AcceptanceModel::parse(given, option));
}

/// Candidates between the same two places.
struct Group {
  std::vector<GroupMember> members;
  bool looked_at = false;  // next to `members`: each new candidate changes both
  bool connecting = false;
  // State of the last evaluation.
  CandidateEvidence evidence;  // of the most promising member that was examined
  detail::RepeatedGain gain;
  Eigen::Isometry3f guess = Eigen::Isometry3f::Identity();  // between the nodes of that member
  std::uint32_t from = 0, to = 0;                           // its nodes
  std::uint32_t sketch = 0;                                 // number of the sketch of the gain
  // Results of the computed candidates.
  double expected = 0.0;        // sum of their chances by evidence
  double expected_right = 0.0;  // verified ones: sum of their chances by evidence to be right
  std::uint32_t verified = 0, refuted = 0;
  std::uint32_t closures_in_sketch = 0;  // believed closures when the gains were sketched
  double in_flight = 0.0;                // expected number of right closures among pending results

  [[nodiscard]] std::uint32_t believed() const { return verified - refuted; }
};

/// A candidate that was handed out or computed.
struct Computed {
  std::uint32_t group = 0;
  Key from = 0, to = 0;
  CandidateEvidence evidence;
  double by_evidence = 0.0;        // chance to be verified
  double chance_verified = 0.0;    // the same, including the results of its group
  double right = 0.0;              // chance to be right if verified, by evidence
  double expected_closures = 0.0;  // expected number of right closures while it was in flight
  bool verified = false, refuted = false;
};

}  // namespace

struct ExpectedPrioritizer::Impl {
  Impl(const ExpectedOptions& given, const ClosureModelOptions& closures, Robots robots, Signature of_scan,
       std::uint64_t seed, std::string_view name)
      : options_(given),
        closures_(closures),
        robots_(robots),
        signature_(std::move(of_scan)),
        pool_(closures.threads),
        seed_(seed),
        name_(name),
        places_(std::move(robots), given.place_m),
        verified_(
            prior(given.verified_weights, "expected.verified_weights", AcceptanceModel::shipped_verified())),
        right_(prior(given.right_weights, "expected.right_weights", AcceptanceModel::shipped_right())) {
    validate(options_);
    validate(closures_);
  }

  // ---- candidates, scans, graph and results

  std::vector<Refusal> add(const std::vector<LoopCandidate>& candidates) {
    std::vector<Refusal> refused;
    for (const LoopCandidate& candidate : candidates) {
      if (candidate.from == candidate.to) {
        refused.push_back({candidate.id, "same_node"});
      } else if (!held_.contains(candidate.id) && unknown_.count(candidate.id) == 0) {
        place(candidate);
      }
    }
    return refused;
  }

  void place(const LoopCandidate& candidate) {
    const auto from = node_.find(candidate.from), to = node_.find(candidate.to);
    if (from == node_.end() || to == node_.end()) {
      unknown_.emplace(candidate.id, candidate);
      return;
    }
    const std::uint32_t g = pairs_.number_of(places_.place_of(from->second), places_.place_of(to->second));
    if (g == groups_.size()) groups_.emplace_back();
    Group& group = groups_[g];
    group.members.push_back({candidate, from->second, to->second, -1.0F});
    group.looked_at = false;  // the new member may be the most promising one
    held_.set(candidate.id, g);
  }

  void remove(const std::vector<CandidateId>& ids) {
    for (const CandidateId id : ids) {
      unknown_.erase(id);
      forget_in_flight(id);
      const std::uint32_t* group = held_.find(id);
      if (group == nullptr) continue;
      const std::vector<GroupMember>& members = groups_[*group].members;
      const auto member = std::find_if(members.begin(), members.end(),
                                       [id](const GroupMember& m) { return m.candidate.id == id; });
      erase(groups_[*group], static_cast<std::size_t>(member - members.begin()));
    }
  }

  /// Removes a member. If it represented its group, the group is evaluated again.
  void erase(Group& group, std::size_t place) {
    const GroupMember& member = group.members[place];
    if (member.from == group.from && member.to == group.to) group.looked_at = false;
    held_.erase(member.candidate.id);
    group.members.erase(group.members.begin() + static_cast<std::ptrdiff_t>(place));
  }

  void on_scan(const KeyedScan& scan) {
    if (!signature_) return;
    ScanSignature signature = signature_(scan);
    if (signature.empty()) return;
    const ScanSignature& kept = signatures_.emplace(scan.key, std::move(signature)).first->second;
    const auto node = node_.find(scan.key);
    if (node != node_.end()) signature_of_[node->second] = &kept;
  }

  void on_graph(const PoseGraph& graph) {
    poses_.resize(graph.nodes().size());
    for (std::size_t i = 0; i < poses_.size(); ++i) poses_[i] = graph.nodes()[i].pose;
    for (std::size_t i = places_.nodes(); i < poses_.size(); ++i) {
      node_.emplace(graph.nodes()[i].key, static_cast<std::uint32_t>(i));
      const auto signature = signatures_.find(graph.nodes()[i].key);
      signature_of_.push_back(signature == signatures_.end() ? nullptr : &signature->second);
    }
    places_.add_nodes(graph);
    const std::size_t parts = parts_ ? parts_->anchored.size() : 0;
    parts_.emplace(graph);
    if (parts_->anchored.size() < parts)
      sketched_size_ = 0.0;  // components were joined, so gains have changed
    learn(graph);            // before the sketch, which uses the closures believed now
    sketch_graph(graph);
    std::vector<LoopCandidate> known;
    for (const auto& [id, candidate] : unknown_) {
      if (node_.count(candidate.from) != 0 && node_.count(candidate.to) != 0) known.push_back(candidate);
    }
    for (const LoopCandidate& candidate : known) {
      unknown_.erase(candidate.id);
      place(candidate);
    }
  }

  void on_result(const RegistrationResult& result) {
    const auto found = in_flight_.find(result.candidate.id);
    if (found == in_flight_.end()) return on_result_of_others(result);
    Computed computed = found->second;
    in_flight_.erase(found);
    computed.verified = result.verified();
    calibration_.add(computed.chance_verified, computed.verified);
    Group& group = groups_[computed.group];
    group.in_flight = std::max(0.0, group.in_flight - computed.expected_closures);
    note(computed);
  }

  /// Learns from a candidate that another prioritiser of the method has chosen.
  void on_result_of_others(const RegistrationResult& result) {
    const LoopCandidate& candidate = result.candidate;
    const auto from = node_.find(candidate.from), to = node_.find(candidate.to);
    if (from == node_.end() || to == node_.end()) return;
    const std::uint32_t* const group =
        pairs_.find(places_.place_of(from->second), places_.place_of(to->second));
    if (group == nullptr) return;
    GroupMember member{candidate, from->second, to->second, -1.0F};
    Computed computed;
    computed.group = *group;
    computed.from = candidate.from;
    computed.to = candidate.to;
    computed.evidence = evidence_of(member);
    computed.by_evidence = verified_.probability(computed.evidence);
    computed.right = right_.probability(computed.evidence);
    computed.verified = result.verified();
    note(computed);
  }

  void note(const Computed& computed) {
    Group& group = groups_[computed.group];
    group.expected += computed.by_evidence;
    if (computed.verified) {
      ++group.verified;
      group.expected_right += computed.right;
    }
    computed_.push_back(computed);
    learned_ = false;
  }

  /// Forgets a candidate that was given back without a result.
  void forget_in_flight(CandidateId id) {
    const auto found = in_flight_.find(id);
    if (found == in_flight_.end()) return;
    Group& group = groups_[found->second.group];
    group.in_flight = std::max(0.0, group.in_flight - found->second.expected_closures);
    in_flight_.erase(found);
  }

  // ---- learning

  void learn(const PoseGraph& graph) {
    std::unordered_set<std::pair<Key, Key>, KeyPairHash> refuted;
    for (const Edge& edge : graph.edges()) {
      if (edge.kind == EdgeKind::kLoopClosure && edge.weight < 0.5) {
        refuted.insert(std::minmax(edge.from, edge.to));
      }
    }
    for (Computed& computed : computed_) {
      if (!computed.verified) continue;
      const bool now = refuted.count(std::minmax(computed.from, computed.to)) != 0;
      if (now == computed.refuted) continue;
      computed.refuted = now;
      groups_[computed.group].refuted += now ? 1U : ~0U;
      learned_ = false;
    }
    if (std::exchange(learned_, true)) return;
    std::vector<std::pair<CandidateEvidence, bool>> verified, right;
    verified.reserve(computed_.size());
    for (const Computed& computed : computed_) {
      verified.emplace_back(computed.evidence, computed.verified);
      if (computed.verified) right.emplace_back(computed.evidence, !computed.refuted);
    }
    verified_.fit(verified);
    right_.fit(right);
  }

  void sketch_graph(const PoseGraph& graph) {
    if (options_.gain_exponent <= 0.0) return;
    const auto size = static_cast<double>(graph.nodes().size() + graph.edges().size());
    if (sketches_ > 0 && size < kRefreshed * sketched_size_) return;
    sketched_size_ = size;
    ++sketches_;
    try {
      sketch_ = detail::RelativeSketch(graph, closures_, static_cast<std::size_t>(options_.probes),
                                       combine_seeds(seed_, sketches_));
    } catch (const InputError&) {  // the graph leaves a pose undetermined, so gains are not defined
      sketch_ = {};
    }
    for (Group& group : groups_) group.closures_in_sketch = group.believed();
  }

  // ---- groups

  [[nodiscard]] Eigen::Isometry3d guess(std::uint32_t from, std::uint32_t to) const {
    return poses_[from].inverse() * poses_[to];
  }

  [[nodiscard]] std::uint32_t sketched(std::uint32_t node) const {
    if (sketch_.empty()) return node;
    while (node >= sketch_.nodes() && places_.before(node) != node) node = places_.before(node);
    return node;
  }

  [[nodiscard]] float overlap_of(const GroupMember& member, const Eigen::Isometry3d& T) const {
    const ScanSignature *from = signature_of_[member.from], *to = signature_of_[member.to];
    if (!options_.use_overlap || from == nullptr || to == nullptr)
      return std::numeric_limits<float>::quiet_NaN();
    return static_cast<float>(predicted_overlap(*from, *to, T));
  }

  /// Evidence by the present estimate, except for the overlap, which is stored.
  [[nodiscard]] CandidateEvidence evidence_of(GroupMember& member) const {
    const auto& recognition = member.candidate.recognition;
    const bool placed = recognition && recognition->T_from_to;
    const Eigen::Isometry3d T = placed ? *recognition->T_from_to : guess(member.from, member.to);
    if (member.overlap < 0.0F) member.overlap = overlap_of(member, T);
    CandidateEvidence out;
    out.overlap = static_cast<double>(member.overlap);
    out.distance_m = T.translation().norm();
    out.from_outside = member.candidate.source != CandidateSource::kProximity && !placed;
    if (placed && recognition->similarity > 0.0) out.similarity = recognition->similarity;
    return out;
  }

  /// Whether the group's guess has moved since the last evaluation.
  [[nodiscard]] bool moved(const Group& group) const {
    const Eigen::Isometry3f now = guess(group.from, group.to).cast<float>();
    if ((now.translation() - group.guess.translation()).squaredNorm() >
        static_cast<float>(kMoved_m * kMoved_m))
      return true;
    // |R − R'|² = 4(1 − cos angle)
    return (now.linear() - group.guess.linear()).squaredNorm() >
           static_cast<float>(2.0 * kMoved_rad * kMoved_rad);
  }

  void look_at(Group& group, bool has_moved) {
    if (has_moved) {
      for (GroupMember& member : group.members) member.overlap = -1.0F;
    }
    const std::size_t n = group.members.size(), examined = std::min(n, kMaxExamined);
    GroupMember& middle = group.members[n / 2];
    make_gain(group, middle.from, middle.to);
    double best = -1.0;
    for (std::size_t k = 0; k < examined; ++k) {
      GroupMember& member = group.members[(2 * k + 1) * n / (2 * examined)];
      const CandidateEvidence evidence = evidence_of(member);
      const double p = verified_.probability(evidence) * right_of(evidence);
      if (p <= best) continue;
      best = p;
      group.evidence = evidence;
      group.from = member.from;
      group.to = member.to;
    }
    group.guess = guess(group.from, group.to).cast<float>();
    group.looked_at = true;
  }

  [[nodiscard]] double right_of(const CandidateEvidence& evidence) const {
    return options_.use_right ? right_.probability(evidence) : 1.0;
  }

  void make_gain(Group& group, std::uint32_t from, std::uint32_t to) {
    group.sketch = sketches_;
    if (options_.gain_exponent <= 0.0) return;
    const std::uint32_t a = sketched(from), b = sketched(to);
    group.connecting = parts_ && parts_->connecting(from, to);
    group.gain = group.connecting ? detail::RepeatedGain() : sketch_.gain(a, b, guess(to, from));
  }

  /// A chance by evidence, corrected by the ratio of observed to expected successes of the group.
  [[nodiscard]] double with_group(double by_evidence, double observed, double expected) const {
    const double factor =
        options_.use_places ? (observed + kPlaceStrength) / (expected + kPlaceStrength) : 1.0;
    return std::min(kMostChance, by_evidence * factor);
  }
  [[nodiscard]] double chance(const Group& group, double by_evidence) const {
    return with_group(by_evidence, group.verified, group.expected);
  }
  [[nodiscard]] double chance_right(const Group& group) const {
    if (!options_.use_right) return 1.0;
    return with_group(right_.probability(group.evidence), group.verified - group.refuted,
                      group.expected_right);
  }

  /// Value of the next candidate of a group: chance times gain, with the gain raised to gain_exponent.
  [[nodiscard]] double value(const Group& group) const {
    const double p = chance(group, verified_.probability(group.evidence)) * chance_right(group);
    if (options_.gain_exponent <= 0.0) return p;
    const double present =
        group.believed() - std::min(group.believed(), group.closures_in_sketch) + group.in_flight;
    const double gain = group.connecting ? largest_gain_ * p / (1.0 + present)
                                         : group.gain.of(present + p) - group.gain.of(present);
    return std::pow(std::max(gain / p, 1e-30), options_.gain_exponent) * p;
  }

  // ---- the draw

  struct Entry {
    double key;
    std::uint32_t group;
    bool operator<(const Entry& other) const {
      return key != other.key ? key < other.key : group > other.group;
    }
  };

  [[nodiscard]] double key_of(std::uint32_t g, std::uint64_t draw) const {
    const double noise = gumbel(combine_seeds(combine_seeds(seed_, round_), (draw << 32) | g));
    return std::log(std::max(value(groups_[g]), 1e-300)) + options_.spread * noise;
  }

  /// Evaluates all groups without a value, and a bounded number of groups with an old value.
  void refresh() {
    std::size_t budget = kRefreshBudget;
    std::vector<std::uint32_t> fresh;
    for (std::uint32_t g = 0; g < groups_.size(); ++g) {
      if (!groups_[g].members.empty() && !groups_[g].looked_at) fresh.push_back(g);
    }
    const std::size_t chunks = (fresh.size() + kGroupsPerTask - 1) / kGroupsPerTask;
    pool_.for_each(chunks, [&](std::size_t chunk) {
      for (std::size_t k = chunk * kGroupsPerTask; k < std::min(fresh.size(), (chunk + 1) * kGroupsPerTask);
           ++k) {
        look_at(groups_[fresh[k]], /*has_moved=*/false);
      }
    });
    const std::size_t n = groups_.size();
    for (std::size_t k = 0; k < n && budget > 0; ++k, next_refreshed_ = (next_refreshed_ + 1) % n) {
      Group& group = groups_[next_refreshed_ % n];
      if (group.members.empty()) continue;
      if (!old(group)) continue;
      bring_up_to_date(group);
      --budget;
    }
    largest_gain_ = 0.0;
    for (const Group& group : groups_) {
      if (!group.members.empty() && !group.connecting)
        largest_gain_ = std::max(largest_gain_, group.gain.of(1.0));
    }
  }

  [[nodiscard]] bool old(const Group& group) const {
    return !group.looked_at || group.sketch != sketches_ || moved(group);
  }
  void bring_up_to_date(Group& group) {
    if (!group.looked_at) {
      look_at(group, moved(group));
    } else if (moved(group)) {
      look_at(group, /*has_moved=*/true);
    } else {
      make_gain(group, group.from, group.to);
    }
  }

  std::vector<LoopCandidate> take(std::size_t count) {
    std::vector<LoopCandidate> out;
    if (count == 0 || held_.size() == 0) return out;
    ++round_;
    refresh();
    std::vector<Entry> heap;
    for (std::uint32_t g = 0; g < groups_.size(); ++g) {
      if (!groups_[g].members.empty()) heap.push_back({key_of(g, 0), g});
    }
    std::make_heap(heap.begin(), heap.end());
    std::unordered_map<std::uint32_t, std::uint64_t> draws;
    while (out.size() < count && !heap.empty()) {
      std::pop_heap(heap.begin(), heap.end());
      const std::uint32_t g = heap.back().group;
      heap.pop_back();
      Group& group = groups_[g];
      std::uint64_t& draw = draws[g];
      if (old(group)) {
        bring_up_to_date(group);
      } else {
        out.push_back(hand_out(g));
        ++draw;
      }
      if (group.members.empty()) continue;
      heap.push_back({key_of(g, draw), g});
      std::push_heap(heap.begin(), heap.end());
    }
    return out;
  }

  /// Hands out the most promising member of a group.
  LoopCandidate hand_out(std::uint32_t g) {
    Group& group = groups_[g];
    const std::size_t n = group.members.size(), step = (n + kMostMembers - 1) / kMostMembers;
    std::size_t best = 0;
    double most = -1.0;
    CandidateEvidence of_best;
    for (std::size_t k = 0; k < n; k += step) {
      const CandidateEvidence evidence = evidence_of(group.members[k]);
      const double p = verified_.probability(evidence) * right_of(evidence);
      if (p <= most) continue;
      most = p;
      best = k;
      of_best = evidence;
    }
    const LoopCandidate candidate = group.members[best].candidate;
    Computed computed;
    computed.group = g;
    computed.from = candidate.from;
    computed.to = candidate.to;
    computed.evidence = of_best;
    computed.by_evidence = verified_.probability(of_best);
    computed.chance_verified = chance(group, computed.by_evidence);
    computed.right = right_.probability(of_best);
    computed.expected_closures = computed.chance_verified * chance_right(group);
    group.in_flight += computed.expected_closures;
    in_flight_[candidate.id] = computed;
    erase(group, best);
    return candidate;
  }

  std::vector<Refusal> give_up(double now_s) {
    std::vector<Refusal> refused;
    if (options_.max_wait_s <= 0.0) return refused;
    while (!unknown_.empty() && now_s - unknown_.begin()->second.time_s > options_.max_wait_s) {
      refused.push_back({unknown_.begin()->first, "missing_node"});
      unknown_.erase(unknown_.begin());
    }
    return refused;
  }

  const ExpectedOptions options_;
  const ClosureModelOptions closures_;
  const Robots robots_;
  const Signature signature_;
  ThreadPool pool_;
  const std::uint64_t seed_;
  const std::string name_;

  detail::Places places_;
  std::unordered_map<Key, std::uint32_t> node_;  // of the graph
  std::vector<Eigen::Isometry3d> poses_;
  std::unordered_map<Key, ScanSignature> signatures_;
  std::vector<const ScanSignature*> signature_of_;  // by node; null: not available

  std::map<CandidateId, LoopCandidate> unknown_;  // candidates with a node that is not in the graph
  IdTable<std::uint32_t> held_;                   // number of their group
  std::vector<Group> groups_;
  detail::PlacePairs pairs_;  // the number of a pair is the number of its group

  std::unordered_map<CandidateId, Computed> in_flight_;
  std::vector<Computed> computed_;
  bool learned_ = true;  // the models are fitted to all results
  AcceptanceModel verified_, right_;
  Calibration calibration_;

  detail::RelativeSketch sketch_;
  std::optional<detail::GraphComponents> parts_;
  std::uint32_t sketches_ = 0;
  double sketched_size_ = 0.0;
  double largest_gain_ = 0.0;
  std::size_t next_refreshed_ = 0;
  std::uint64_t round_ = 0;
};

ExpectedPrioritizer::ExpectedPrioritizer(const ExpectedOptions& options, const ClosureModelOptions& closures,
                                         Robots robots, Signature signature, std::uint64_t seed,
                                         std::string_view name)
    : impl_(std::make_unique<Impl>(options, closures, std::move(robots), std::move(signature), seed, name)) {}
ExpectedPrioritizer::~ExpectedPrioritizer() = default;

std::string_view ExpectedPrioritizer::name() const {
  return impl_->name_;
}
std::vector<Refusal> ExpectedPrioritizer::add(const std::vector<LoopCandidate>& candidates) {
  for (const LoopCandidate& candidate : candidates) impl_->forget_in_flight(candidate.id);
  return impl_->add(candidates);
}
void ExpectedPrioritizer::remove(const std::vector<CandidateId>& ids) {
  impl_->remove(ids);
}
void ExpectedPrioritizer::on_graph(const PoseGraph& graph) {
  impl_->on_graph(graph);
}
void ExpectedPrioritizer::on_scan(const KeyedScan& scan) {
  impl_->on_scan(scan);
}
void ExpectedPrioritizer::on_result(const RegistrationResult& result) {
  impl_->on_result(result);
}
std::vector<LoopCandidate> ExpectedPrioritizer::take(std::size_t count) {
  return impl_->take(count);
}
std::vector<Refusal> ExpectedPrioritizer::give_up(double now_s) {
  return impl_->give_up(now_s);
}
std::size_t ExpectedPrioritizer::size() const {
  return impl_->held_.size() + impl_->unknown_.size();
}
const Calibration* ExpectedPrioritizer::calibration() const {
  return &impl_->calibration_;
}
const AcceptanceModel& ExpectedPrioritizer::acceptance() const {
  return impl_->verified_;
}

}  // namespace loopwise
