// SPDX-License-Identifier: BSD-3-Clause
#include "network_tensors.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace loopwise::training {
namespace {

namespace F = torch::nn::functional;
constexpr double kSharp = 6.0;
constexpr double kLogBound = 20.0;

torch::Tensor soft_sign(const torch::Tensor& x) {
  return x / (1.0 + x.abs());
}

}  // namespace

// ---- the Loopwise network

EffectBatch effect_batch(const TrainingGraph& graph, torch::ScalarType type) {
  const ClosureEffects& e = graph.effects;
  const auto L = static_cast<std::int64_t>(e.candidates()), U = static_cast<std::int64_t>(e.unit_count());
  const auto S = static_cast<std::int64_t>(graph.sets.size());
  EffectBatch out;
  out.trace_m2 = e.trace_m2;
  const auto real = torch::TensorOptions().dtype(torch::kFloat64);
  out.edges = torch::empty({L, U, kEdge}, real);
  for (std::int64_t c = 0; c < L; ++c) {
    const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> features =
        e.edge_features(c);
    std::copy(features.data(), features.data() + features.size(),
              out.edges.data_ptr<double>() + c * U * kEdge);
  }
  const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> units = e.units;
  out.units = torch::from_blob(const_cast<double*>(units.data()), {U, kUnit}, real).clone();
  out.share = torch::from_blob(const_cast<double*>(e.share.data()), {U}, real).clone();
  out.active = torch::ones({L}, real);
  for (std::int64_t c = 0; c < L; ++c) {
    if (e.connecting[static_cast<std::size_t>(c)]) out.active[c] = 0.0;
  }
  out.beside = torch::zeros({U, U}, real);
  const auto A = static_cast<std::int64_t>(e.anchors.size());
  for (std::int64_t a = 0; a < A; ++a) {
    std::vector<std::int64_t> next;
    for (const std::int64_t b : {a - 1, a + 1}) {
      if (b < 0 || b >= A) continue;
      if (e.anchors[static_cast<std::size_t>(a)].chain == e.anchors[static_cast<std::size_t>(b)].chain)
        next.push_back(b);
    }
    for (const std::int64_t b : next) {
      for (std::int64_t k = 0; k < 3; ++k) {
        out.beside.data_ptr<double>()[(3 * a + k) * U + 3 * b + k] = 1.0 / static_cast<double>(next.size());
      }
    }
  }
  out.members = torch::zeros({S, L}, real);
  out.log_e = torch::empty({S}, real);
  out.log_reduction = torch::empty({S, U}, real);
  out.swaps = torch::zeros({S}, real);
  std::vector<std::uint32_t> before;
  for (std::int64_t s = 0; s < S; ++s) {
    const TrainingSet& set = graph.sets[static_cast<std::size_t>(s)];
    for (const std::uint32_t c : set.members) out.members[s][c] = 1.0;
    out.log_e[s] = std::log(set.trace_m2 / e.trace_m2);
    for (std::int64_t u = 0; u < U; ++u) {
      out.log_reduction.data_ptr<double>()[s * U + u] = static_cast<double>(set.log_reduction[u]);
    }
    std::vector<std::uint32_t> members = set.members, common;
    std::sort(members.begin(), members.end());
    std::set_intersection(members.begin(), members.end(), before.begin(), before.end(),
                          std::back_inserter(common));
    if (members.size() > 1 && members.size() == before.size() && common.size() + 1 == members.size()) {
      out.swaps[s] = 1.0;
    }
    before = std::move(members);
  }
  for (torch::Tensor* t : {&out.edges, &out.units, &out.share, &out.active, &out.beside, &out.members,
                           &out.log_e, &out.log_reduction, &out.swaps}) {
    *t = t->to(type);
  }
  return out;
}

std::pair<torch::Tensor, torch::Tensor> effect_forward(const TensorMap& w, const EffectBatch& batch) {
  const auto L = batch.edges.size(0), U = batch.edges.size(1), S = batch.members.size(0);
  const torch::Tensor a = (batch.edges - w.at("edge.mean")) / w.at("edge.std");
  const torch::Tensor h = soft_sign(F::linear(a, w.at("message.0.weight"), w.at("message.0.bias")));
  const torch::Tensor z = (F::linear(h, w.at("message.1.weight"), w.at("message.1.bias")) +
                           F::linear(a, w.at("message.skip.weight")))
                              .clamp(-kLogBound, kLogBound);
  const torch::Tensor r = batch.edges.select(2, 0).unsqueeze(2);
  torch::Tensor m = torch::cat({z.exp(), r.expm1(), (kSharp * r).expm1()}, 2);
  const std::int64_t C = m.size(2);
  m = m * batch.active.view({L, 1, 1});
  const torch::Tensor sums = torch::matmul(batch.members, m.view({L, U * C})).view({S, U, C});
  const torch::Tensor logs = sums.log1p();
  const torch::Tensor p = logs.select(2, C - 2), q = logs.select(2, C - 1) / kSharp;
  const torch::Tensor pooled = torch::cat({logs.narrow(2, 0, C - 1), q.unsqueeze(2)}, 2);  // S × U × C
  const torch::Tensor whole = (pooled * batch.share.view({1, U, 1})).sum(1);
  const torch::Tensor f = (batch.units - w.at("unit.mean")) / w.at("unit.std");
  const torch::Tensor& first = w.at("readout.0.weight");
  torch::Tensor x = F::linear(pooled, first.narrow(1, 0, C)) +
                    torch::matmul(batch.beside, F::linear(pooled, first.narrow(1, C, C))) +
                    F::linear(whole, first.narrow(1, 2 * C, C)).unsqueeze(1) +
                    F::linear(f, first.narrow(1, 3 * C, kUnit), w.at("readout.0.bias")).unsqueeze(0);
  x = soft_sign(x);
  x = soft_sign(F::linear(x, w.at("readout.1.weight"), w.at("readout.1.bias")));
  x = F::linear(x, w.at("readout.2.weight"), w.at("readout.2.bias"));
  const torch::Tensor y = q + x.select(2, 0).sigmoid() * (p - q) - x.select(2, 1) * (-p).expm1();
  const torch::Tensor log_e = ((-y).exp() * batch.share).sum(1).log();
  return {y, log_e};
}

torch::Tensor effect_loss(const TensorMap& w, const EffectBatch& batch) {
  const auto [y, log_e] = effect_forward(w, batch);
  const torch::Tensor error = log_e - batch.log_e;
  const torch::Tensor left = batch.share * (-batch.log_reduction).exp();
  const torch::Tensor weight = 0.5 * left / left.sum(1, true) + 0.5 * batch.share;
  const torch::Tensor units = (weight * (y - batch.log_reduction).pow(2)).sum(1).mean();
  torch::Tensor loss = error.pow(2).mean() + 0.2 * units;
  const auto S = batch.members.size(0);
  if (S > 1) {
    const torch::Tensor chosen = batch.swaps.narrow(0, 1, S - 1);
    const torch::Tensor change = (batch.log_e.narrow(0, 1, S - 1) - batch.log_e.narrow(0, 0, S - 1)) * chosen;
    const torch::Tensor guess = (log_e.narrow(0, 1, S - 1) - log_e.narrow(0, 0, S - 1)) * chosen;
    const torch::Tensor scale = change.abs().sum() / chosen.sum().clamp_min(1.0) + 1e-4;
    const torch::Tensor off = (guess - change) / scale;
    loss = loss + 0.02 * ((1.0 + off.pow(2)).sqrt() - 1.0).sum() / chosen.sum().clamp_min(1.0);
  }
  return loss;
}

// ---- the paper's network

PaperBatch paper_batch(const std::vector<PaperSample>& samples, torch::ScalarType type) {
  std::vector<double> nodes, traces;
  std::vector<std::int64_t> owner, source[kEdgeTypes], target[kEdgeTypes];
  std::vector<double> incoming;
  PaperBatch out;
  std::int64_t offset = 0;
  for (std::size_t s = 0; s < samples.size(); ++s) {
    const TrainingGraph& graph = *samples[s].graph;
    const auto n = static_cast<std::int64_t>(graph.input.nodes.rows());
    incoming.resize(incoming.size() + static_cast<std::size_t>(n), 0.0);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index d = 0; d < kNodeFeatures; ++d) nodes.push_back(graph.input.nodes(i, d));
      owner.push_back(static_cast<std::int64_t>(s));
    }
    const auto connect = [&](std::uint32_t from, std::uint32_t to, std::size_t kind) {
      source[kind].push_back(offset + from);
      target[kind].push_back(offset + to);
      incoming[static_cast<std::size_t>(offset + to)] += 1.0;
    };
    for (std::size_t e = 0; e < graph.input.edges.size(); ++e) {
      Eigen::Index kind = 0;
      graph.input.edge_attributes.row(static_cast<Eigen::Index>(e)).maxCoeff(&kind);
      connect(graph.input.edges[e].first, graph.input.edges[e].second, static_cast<std::size_t>(kind));
    }
    for (const std::uint32_t c : samples[s].set->members) {
      connect(graph.ends[c].first, graph.ends[c].second, 2);  // a closure's type
    }
    traces.push_back(samples[s].set->trace_m2);
    out.group.push_back(samples[s].group);
    offset += n;
  }
  const auto tensor = [](const auto& values, torch::ScalarType as) {
    return torch::tensor(values, torch::TensorOptions().dtype(as));
  };
  out.nodes = tensor(nodes, type).view({offset, kNodeFeatures});
  out.graph = tensor(owner, torch::kInt64);
  out.incoming = tensor(incoming, type).clamp_min(1.0).unsqueeze(1);
  out.trace = tensor(traces, type);
  for (std::size_t t = 0; t < kEdgeTypes; ++t) {
    if (source[t].empty()) continue;
    out.source[t] = tensor(source[t], torch::kInt64);
    out.target[t] = tensor(target[t], torch::kInt64);
  }
  return out;
}

torch::Tensor paper_forward(const TensorMap& w, const PaperBatch& batch, bool training) {
  torch::Tensor h = (batch.nodes - w.at("input.mean")) / w.at("input.std");
  h = F::linear(h, w.at("node_encoder.weight"), w.at("node_encoder.bias"));
  const std::int64_t H = h.size(1);
  for (std::int64_t l = 0; l < kConvolutions; ++l) {
    const std::string name = l == 0 ? "conv1" : "gcs." + std::to_string(l - 1);
    const torch::Tensor &mu = w.at(name + ".mu"), &sigma = w.at(name + ".sigma");
    const std::int64_t K = mu.size(0);
    const torch::Tensor types = torch::eye(kEdgeTypes, mu.options()).unsqueeze(1);
    const torch::Tensor kernel =
        (-0.5 * ((types - mu).pow(2) / (1e-15 + sigma.pow(2))).sum(2)).exp();  // types × K
    const torch::Tensor G = torch::einsum("tk,hko->tho", {kernel, w.at(name + ".g").view({H, K, H})});
    torch::Tensor sum = torch::zeros_like(h);
    for (std::size_t t = 0; t < kEdgeTypes; ++t) {
      if (!batch.source[t].defined()) continue;
      sum = sum.index_add(0, batch.target[t],
                          torch::matmul(h.index_select(0, batch.source[t]), G[static_cast<std::int64_t>(t)]));
    }
    h = sum / batch.incoming + torch::matmul(h, w.at(name + ".root")) + w.at(name + ".bias");
    if (l + 1 < kConvolutions) h = h.tanh();
  }
  torch::Tensor p = torch::zeros({batch.trace.size(0), H}, h.options()).index_add(0, batch.graph, h);
  const auto normalize = [&](std::int64_t number) {
    const std::string name = "batch_norms." + std::to_string(number);
    p = torch::batch_norm(p, w.at(name + ".weight"), w.at(name + ".bias"), w.at(name + ".running_mean"),
                          w.at(name + ".running_var"), training, 0.1, 1e-5, false);
  };
  for (std::int64_t l = 0; l < kDense; ++l) {
    normalize(l + 1);
    const std::string name = "lins." + std::to_string(l);
    p = F::linear(p, w.at(name + ".weight"), w.at(name + ".bias")).tanh();
  }
  normalize(kDense + 1);
  return F::linear(p, w.at("lin.weight"), w.at("lin.bias")).squeeze(1);
}

torch::Tensor paper_loss(const TensorMap& w, const PaperBatch& batch, bool training, bool logarithm) {
  const torch::Tensor truth =
      ((logarithm ? batch.trace.log() : batch.trace) - w.at("output.mean")) / w.at("output.std");
  const torch::Tensor error = paper_forward(w, batch, training) - truth;
  torch::Tensor loss = error.pow(2).mean();
  std::vector<torch::Tensor> within;
  for (std::size_t first = 0; first < batch.group.size();) {
    std::size_t end = first;
    while (end < batch.group.size() && batch.group[end] == batch.group[first]) ++end;
    const auto begin = static_cast<std::int64_t>(first), size = static_cast<std::int64_t>(end - first);
    if (size > 1) {
      const torch::Tensor e = error.narrow(0, begin, size), t = truth.narrow(0, begin, size);
      within.push_back(
          ((e - e.mean()).pow(2).mean() / ((t - t.mean()).pow(2).mean() + 1e-3)).clamp_max(100.0));
    }
    first = end;
  }
  if (!within.empty()) loss = loss + 0.3 * torch::stack(within).mean();
  return loss;
}

}  // namespace loopwise::training
