// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/effect_network.hpp>

#include <cmath>
#include <optional>

#include <loopwise/core/error.hpp>

#include "tensor_file.hpp"

namespace loopwise {
namespace {

using Eigen::ArrayXXd;
using Eigen::Index;

/// Number of channels that are not learned: one adds up the information of independent closures, the other
/// approximates the largest one.
constexpr Index kFixed = 2;
constexpr double kSharp = 6.0;
/// Logarithms of messages are clamped to ±this; log_reductions alone would allow 6·9.
constexpr double kLogBound = 20.0;
/// Subtracting a message leaves a rounding error. If less than this share of the sum remains, the sum is
/// computed again.
constexpr double kLostShare = 1e-6;

template <class Derived>
auto soft_sign(const Eigen::ArrayBase<Derived>& x) {
  return x / (1.0 + x.abs());
}

}  // namespace

struct EffectNetwork::Impl {
  Eigen::RowVectorXd edge_mean, edge_std, unit_mean, unit_std;
  Eigen::MatrixXd message_0, message_1, message_skip, readout_0, readout_1, readout_2;
  Eigen::RowVectorXd message_bias_0, message_bias_1, readout_bias_0, readout_bias_1, readout_bias_2;

  [[nodiscard]] Index learned() const { return message_1.rows(); }
  [[nodiscard]] Index channels() const { return learned() + kFixed; }

  /// Contribution of a closure to the sums of each unit: units × channels.
  [[nodiscard]] ArrayXXd messages(const ClosureEffects& effects, Index candidate) const {
    const Eigen::MatrixXd raw = effects.edge_features(candidate);
    const Eigen::MatrixXd a = (raw.rowwise() - edge_mean).array().rowwise() / edge_std.array();
    Eigen::MatrixXd hidden = (a * message_0.transpose()).rowwise() + message_bias_0;
    hidden = soft_sign(hidden.array()).matrix().eval();
    const Eigen::MatrixXd z =
        ((hidden * message_1.transpose() + a * message_skip.transpose()).rowwise() + message_bias_1);
    ArrayXXd out(z.rows(), channels());
    out.leftCols(learned()) = z.array().cwiseMin(kLogBound).cwiseMax(-kLogBound).exp();
    out.col(learned()) = raw.col(0).array().exp() - 1.0;
    out.col(learned() + 1) = (kSharp * raw.col(0).array()).exp() - 1.0;
    return out;
  }

  /// The part of the readout's first layer that does not depend on the set.
  [[nodiscard]] Eigen::MatrixXd unit_part(const ClosureEffects& effects) const {
    const Eigen::MatrixXd f = (effects.units.rowwise() - unit_mean).array().rowwise() / unit_std.array();
    return (f * readout_0.rightCols(ClosureEffects::kUnitFeatures).transpose()).rowwise() + readout_bias_0;
  }

  /// Means over the neighbouring anchors of each unit's anchor on its chain, along the axis of the same rank.
  [[nodiscard]] static Eigen::MatrixXd beside(const ClosureEffects& effects, const Eigen::MatrixXd& pooled) {
    Eigen::MatrixXd out = Eigen::MatrixXd::Zero(pooled.rows(), pooled.cols());
    const std::size_t A = effects.anchors.size();
    for (std::size_t a = 0; a < A; ++a) {
      const bool left = a > 0 && effects.anchors[a - 1].chain == effects.anchors[a].chain;
      const bool right = a + 1 < A && effects.anchors[a + 1].chain == effects.anchors[a].chain;
      const auto at = static_cast<Index>(3 * a);
      auto rows = out.middleRows<3>(at);
      if (left) rows += pooled.middleRows<3>(at - 3);
      if (right) rows += pooled.middleRows<3>(at + 3);
      if (left && right) rows *= 0.5;
    }
    return out;
  }

  /// The predicted trace, from the sums of messages.
  [[nodiscard]] double trace(const ClosureEffects& effects, const Eigen::MatrixXd& fixed,
                             const ArrayXXd& sums) const {
    if (sums.rows() == 0) return effects.trace_m2;
    const Index C = channels();
    Eigen::MatrixXd pooled = (1.0 + sums.max(0.0)).log().matrix();
    pooled.col(C - 1) /= kSharp;
    const Eigen::RowVectorXd whole = effects.share.transpose() * pooled;
    Eigen::MatrixXd h = fixed;
    h.noalias() += pooled * readout_0.leftCols(C).transpose();
    h.noalias() += beside(effects, pooled) * readout_0.middleCols(C, C).transpose();
    h.rowwise() += whole * readout_0.middleCols(2 * C, C).transpose();
    h = soft_sign(h.array()).matrix().eval();
    Eigen::MatrixXd g = readout_bias_1.replicate(h.rows(), 1);
    g.noalias() += h * readout_1.transpose();
    g = soft_sign(g.array()).matrix().eval();
    const Eigen::MatrixXd out = (g * readout_2.transpose()).rowwise() + readout_bias_2;
    const Eigen::ArrayXd p = pooled.col(C - 2).array(), q = pooled.col(C - 1).array();
    const Eigen::ArrayXd mix = 1.0 / (1.0 + (-out.col(0).array()).exp());
    const Eigen::ArrayXd y = q + mix * (p - q) + out.col(1).array() * (1.0 - (-p).exp());
    return effects.trace_m2 * (effects.share.array() * (-y).exp()).sum();
  }
};

EffectNetwork::EffectNetwork(const std::filesystem::path& weights) {
  const detail::TensorFile file(weights);
  if (file.kind() != "loopwise") file.fail("a network of kind " + file.kind() + ", expected loopwise");
  auto impl = std::make_unique<Impl>();
  Impl& m = *impl;
  constexpr Index E = ClosureEffects::kEdgeFeatures, F = ClosureEffects::kUnitFeatures;
  m.edge_mean = file.row("edge.mean", E);
  m.edge_std = file.row("edge.std", E);
  m.unit_mean = file.row("unit.mean", F);
  m.unit_std = file.row("unit.std", F);
  if (!(m.edge_std.minCoeff() > 0.0)) file.fail("edge.std: a value is not positive");
  if (!(m.unit_std.minCoeff() > 0.0)) file.fail("unit.std: a value is not positive");
  m.message_0 = file.matrix("message.0.weight", 0, E);
  const Index M = m.message_0.rows();
  m.message_bias_0 = file.row("message.0.bias", M);
  m.message_1 = file.matrix("message.1.weight", 0, M);
  const Index K = m.message_1.rows();
  m.message_bias_1 = file.row("message.1.bias", K);
  m.message_skip = file.matrix("message.skip.weight", K, E);
  m.readout_0 = file.matrix("readout.0.weight", 0, 3 * (K + kFixed) + F);
  const Index H = m.readout_0.rows();
  m.readout_bias_0 = file.row("readout.0.bias", H);
  m.readout_1 = file.matrix("readout.1.weight", H, H);
  m.readout_bias_1 = file.row("readout.1.bias", H);
  m.readout_2 = file.matrix("readout.2.weight", 2, H);
  m.readout_bias_2 = file.row("readout.2.bias", 2);
  impl_ = std::move(impl);
}

EffectNetwork::~EffectNetwork() = default;
EffectNetwork::EffectNetwork(EffectNetwork&&) noexcept = default;
EffectNetwork& EffectNetwork::operator=(EffectNetwork&&) noexcept = default;

double EffectNetwork::evaluate(const ClosureEffects& effects, const std::vector<std::size_t>& set) const {
  ArrayXXd sums = ArrayXXd::Zero(effects.unit_count(), impl_->channels());
  for (const std::size_t candidate : set) {
    if (candidate >= static_cast<std::size_t>(effects.candidates())) {
      throw InputError("candidate " + std::to_string(candidate) + " of " +
                       std::to_string(effects.candidates()) + " does not exist");
    }
    if (effects.connecting[candidate]) continue;
    sums += impl_->messages(effects, static_cast<Index>(candidate));
  }
  return impl_->trace(effects, impl_->unit_part(effects), sums);
}

struct EffectObjective::Impl {
  Impl(ClosureEffects given, std::shared_ptr<const EffectNetwork> shared)
      : effects(std::move(given)),
        network(std::move(shared)),
        set(static_cast<std::size_t>(effects.candidates())) {
    if (!network) throw InputError("EffectObjective needs a network");
    const EffectNetwork::Impl& net = *network->impl_;
    fixed = net.unit_part(effects);
    messages.reserve(set_size());
    for (std::size_t c = 0; c < set_size(); ++c) {
      messages.push_back(effects.connecting[c]
                             ? ArrayXXd(ArrayXXd::Zero(effects.unit_count(), net.channels()))
                             : net.messages(effects, static_cast<Index>(c)));
    }
    sum_up();
  }

  ClosureEffects effects;
  std::shared_ptr<const EffectNetwork> network;
  CandidateSet set;
  Eigen::MatrixXd fixed;
  std::vector<ArrayXXd> messages;  // by candidate
  ArrayXXd sums;                   // of the set
  std::optional<double> current;
  ArrayXXd scratch;

  [[nodiscard]] std::size_t set_size() const { return static_cast<std::size_t>(effects.candidates()); }

  void sum_up() {
    sums = ArrayXXd::Zero(effects.unit_count(), network->impl_->channels());
    for (const std::size_t member : set.members()) sums += messages[member];
    current.reset();
  }

  [[nodiscard]] double value() {
    if (!current) current = network->impl_->trace(effects, fixed, sums);
    return *current;
  }

  [[nodiscard]] double after(const std::size_t* out, const std::size_t* in) {
    scratch = sums;
    if (out != nullptr) {
      scratch -= messages[*out];
      for (Index k = 0; k < scratch.cols(); ++k) {
        for (Index u = 0; u < scratch.rows(); ++u) {
          if (scratch(u, k) >= kLostShare * sums(u, k)) continue;
          double sum = 0.0;
          for (const std::size_t member : set.members()) {
            if (member != *out) sum += messages[member](u, k);
          }
          scratch(u, k) = sum;
        }
      }
    }
    if (in != nullptr) scratch += messages[*in];
    const double now = value();
    return network->impl_->trace(effects, fixed, scratch) - now;
  }
};

EffectObjective::EffectObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                                 std::shared_ptr<const EffectNetwork> network,
                                 const ClosureModelOptions& options, const ClosureModel& model)
    : impl_(std::make_unique<Impl>(closure_effects(graph, candidates, options, model), std::move(network))) {}
EffectObjective::EffectObjective(ClosureEffects effects, std::shared_ptr<const EffectNetwork> network)
    : impl_(std::make_unique<Impl>(std::move(effects), std::move(network))) {}
EffectObjective::~EffectObjective() = default;

std::size_t EffectObjective::size() const {
  return impl_->set_size();
}
const std::vector<std::size_t>& EffectObjective::selected() const {
  return impl_->set.members();
}
bool EffectObjective::contains(std::size_t candidate) const {
  return impl_->set.contains(candidate);
}
bool EffectObjective::connecting(std::size_t candidate) const {
  return impl_->effects.connecting[candidate];
}
const ClosureEffects& EffectObjective::effects() const {
  return impl_->effects;
}
double EffectObjective::value() {
  return impl_->value();
}
double EffectObjective::add_change(std::size_t candidate) {
  return impl_->after(nullptr, &candidate);
}
double EffectObjective::remove_change(std::size_t candidate) {
  return impl_->after(&candidate, nullptr);
}
double EffectObjective::swap_change(std::size_t out, std::size_t in) {
  return impl_->after(&out, &in);
}
std::vector<double> EffectObjective::add_changes() {
  std::vector<double> out(size(), 0.0);
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (!contains(i) && !connecting(i)) out[i] = add_change(i);
  }
  return out;
}
void EffectObjective::assign(const std::vector<std::size_t>& set) {
  impl_->set.assign(set);
  impl_->sum_up();
}
void EffectObjective::add(std::size_t candidate) {
  impl_->set.add(candidate);
  impl_->sum_up();
}
void EffectObjective::remove(std::size_t candidate) {
  impl_->set.remove(candidate);
  impl_->sum_up();
}
void EffectObjective::swap(std::size_t out, std::size_t in) {
  impl_->set.swap(out, in);
  impl_->sum_up();
}

std::string network_kind(const std::filesystem::path& weights) {
  const detail::TensorFile file(weights);
  std::string kind = file.kind();
  if (kind != "paper" && kind != "loopwise") {
    file.fail("a network of kind " + kind + ", expected paper or loopwise");
  }
  return kind;
}

}  // namespace loopwise
