// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/gnn.hpp>

#include <algorithm>
#include <cmath>
#include <map>

#include <loopwise/core/error.hpp>

#include "closure_factor.hpp"
#include "tensor_file.hpp"

namespace loopwise {
namespace {

using detail::TensorFile;
using Eigen::Index;

struct Convolution {
  Eigen::MatrixXd g;  // H × K·H
  Eigen::MatrixXd mu, sigma;
  Eigen::MatrixXd root;
  Eigen::RowVectorXd bias;
};

struct Linear {
  Eigen::MatrixXd weight;
  Eigen::RowVectorXd bias;
};

/// y = x·scale + shift: batch normalisation at inference.
struct Affine {
  Eigen::RowVectorXd scale, shift;
};

/// The weights of the network in one precision. The kernels are summed per type of edge: messages of edges
/// with the same attributes share one H × H matrix.
template <class Scalar>
struct Layers {
  using Matrix = Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Row = Eigen::Matrix<Scalar, 1, Eigen::Dynamic>;
  struct Layer {
    std::vector<Matrix> message;  // by edge type
    Matrix root;
    Row bias;
  };
  Matrix encoder;  // F × H
  Row encoder_bias;
  std::vector<Layer> layers;
};

}  // namespace

struct GraphNetwork::Impl {
  Linear encoder;
  std::vector<Convolution> convolutions;
  std::vector<Linear> dense;
  std::vector<Affine> norms;
  Linear last;
  Eigen::RowVectorXd input_mean, input_std;
  double output_mean = 0.0, output_std = 1.0;
  bool logarithm = false;  // the output so far is a logarithm

  /// Sums the kernels for edges with these attributes, one type per row.
  template <class Scalar>
  [[nodiscard]] Layers<Scalar> layers(const Eigen::MatrixXd& attributes) const {
    Layers<Scalar> out;
    out.encoder = encoder.weight.transpose().cast<Scalar>();
    out.encoder_bias = encoder.bias.cast<Scalar>();
    const Index hidden = encoder.weight.rows();
    for (const Convolution& c : convolutions) {
      typename Layers<Scalar>::Layer layer;
      for (Index type = 0; type < attributes.rows(); ++type) {
        Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(hidden, hidden);
        for (Index k = 0; k < c.mu.rows(); ++k) {
          double exponent = 0.0;
          for (Index d = 0; d < c.mu.cols(); ++d) {
            const double distance = attributes(type, d) - c.mu(k, d);
            exponent -= 0.5 * distance * distance / (1e-15 + c.sigma(k, d) * c.sigma(k, d));
          }
          sum += std::exp(exponent) * c.g.middleCols(k * hidden, hidden);
        }
        layer.message.push_back(sum.cast<Scalar>());
      }
      layer.root = c.root.cast<Scalar>();
      layer.bias = c.bias.cast<Scalar>();
      out.layers.push_back(std::move(layer));
    }
    return out;
  }

  [[nodiscard]] Eigen::MatrixXd normalized(const Eigen::MatrixXd& nodes) const {
    if (input_mean.size() == 0) return nodes;
    return (nodes.rowwise() - input_mean).array().rowwise() / input_std.array();
  }

  /// The dense layers, from the sum over nodes to y.
  template <class Scalar>
  [[nodiscard]] double head(const Eigen::Matrix<Scalar, 1, Eigen::Dynamic>& sum) const {
    Eigen::Matrix<Scalar, 1, Eigen::Dynamic> p = sum;
    const auto normalize = [&](const Affine& norm) {
      p = p.cwiseProduct(norm.scale.cast<Scalar>()) + norm.shift.cast<Scalar>();
    };
    for (std::size_t l = 0; l < dense.size(); ++l) {
      normalize(norms[l]);
      p = (p * dense[l].weight.transpose().cast<Scalar>() + dense[l].bias.cast<Scalar>()).eval();
      p = p.array().tanh().matrix().eval();
    }
    normalize(norms.back());
    const Scalar y = p.dot(last.weight.row(0).cast<Scalar>()) + static_cast<Scalar>(last.bias[0]);
    const double out = static_cast<double>(y) * output_std + output_mean;
    return logarithm ? std::exp(out) : out;
  }

  template <class Scalar>
  [[nodiscard]] double evaluate(const Input& input) const {
    using Matrix = typename Layers<Scalar>::Matrix;
    if (input.nodes.cols() != encoder.weight.cols() && input.nodes.rows() > 0) {
      throw InputError(std::to_string(input.nodes.cols()) + " node features, expected " +
                       std::to_string(encoder.weight.cols()));
    }
    const auto count = static_cast<Index>(input.edges.size());
    if (input.edge_attributes.rows() != count ||
        (count > 0 && input.edge_attributes.cols() != convolutions.front().mu.cols())) {
      throw InputError("edge attributes are " + std::to_string(input.edge_attributes.rows()) + "x" +
                       std::to_string(input.edge_attributes.cols()) + ", expected " + std::to_string(count) +
                       "x" + std::to_string(convolutions.front().mu.cols()));
    }
    for (const auto& [from, to] : input.edges) {
      if (std::max(from, to) >= static_cast<std::size_t>(input.nodes.rows())) {
        throw InputError("edge " + std::to_string(from) + " " + std::to_string(to) + ": no such node");
      }
    }
    // Edges with equal attributes have the same type.
    std::map<std::vector<double>, std::size_t> types;
    std::vector<std::size_t> type(input.edges.size());
    std::vector<Index> first;
    for (Index e = 0; e < count; ++e) {
      const Eigen::RowVectorXd row = input.edge_attributes.row(e);
      const auto [found, fresh] =
          types.emplace(std::vector<double>(row.data(), row.data() + row.size()), types.size());
      if (fresh) first.push_back(e);
      type[static_cast<std::size_t>(e)] = found->second;
    }
    Eigen::MatrixXd attributes(static_cast<Index>(first.size()), input.edge_attributes.cols());
    for (std::size_t t = 0; t < first.size(); ++t) {
      attributes.row(static_cast<Index>(t)) = input.edge_attributes.row(first[t]);
    }
    const Layers<Scalar> network = layers<Scalar>(attributes);

    Matrix h = (normalized(input.nodes).cast<Scalar>() * network.encoder).rowwise() + network.encoder_bias;
    for (std::size_t l = 0; l < network.layers.size(); ++l) {
      const auto& layer = network.layers[l];
      std::vector<Matrix> messages;
      for (const Matrix& G : layer.message) messages.push_back(h * G);
      Matrix sum = Matrix::Zero(h.rows(), h.cols());
      std::vector<int> incoming(static_cast<std::size_t>(h.rows()), 0);
      for (std::size_t e = 0; e < input.edges.size(); ++e) {
        const auto [from, to] = input.edges[e];
        sum.row(to) += messages[type[e]].row(from);
        ++incoming[to];
      }
      for (Index i = 0; i < h.rows(); ++i) {
        sum.row(i) /= static_cast<Scalar>(std::max(1, incoming[static_cast<std::size_t>(i)]));
      }
      h = ((sum + h * layer.root).rowwise() + layer.bias).eval();
      if (l + 1 < network.layers.size()) h = h.array().tanh().matrix().eval();
    }
    return head<Scalar>(h.colwise().sum());
  }
};

GraphNetwork::GraphNetwork(const std::filesystem::path& weights) {
  const TensorFile file(weights);
  if (file.kind() != "paper") file.fail("a network of kind " + file.kind() + ", expected paper");
  auto impl = std::make_unique<Impl>();
  Impl& m = *impl;
  m.encoder.weight = file.matrix("node_encoder.weight", 0, 0);
  const Index H = m.encoder.weight.rows(), F = m.encoder.weight.cols();
  m.encoder.bias = file.row("node_encoder.bias", H);
  Index D = 0;
  for (std::size_t l = 0;; ++l) {
    const std::string name = l == 0 ? "conv1" : "gcs." + std::to_string(l - 1);
    if (l > 0 && !file.has(name + ".g")) break;
    Convolution c;
    c.mu = file.matrix(name + ".mu", 0, D);
    D = c.mu.cols();
    c.sigma = file.matrix(name + ".sigma", c.mu.rows(), D);
    c.g = file.matrix(name + ".g", H, c.mu.rows() * H);
    c.root = file.matrix(name + ".root", H, H);
    c.bias = file.row(name + ".bias", H);
    m.convolutions.push_back(std::move(c));
  }
  while (file.has("lins." + std::to_string(m.dense.size()) + ".weight")) {
    const std::string name = "lins." + std::to_string(m.dense.size());
    m.dense.push_back({file.matrix(name + ".weight", H, H), file.row(name + ".bias", H)});
  }
  for (std::size_t l = 0; l <= m.dense.size(); ++l) {
    const std::string name = "batch_norms." + std::to_string(l + 1);
    const Eigen::RowVectorXd variance = file.row(name + ".running_var", H);
    if (variance.minCoeff() < 0.0) file.fail(name + ".running_var: a variance is negative");
    Affine norm;
    norm.scale = file.row(name + ".weight", H).array() / (variance.array() + 1e-5).sqrt();
    norm.shift = file.row(name + ".bias", H) - file.row(name + ".running_mean", H).cwiseProduct(norm.scale);
    m.norms.push_back(std::move(norm));
  }
  m.last = {file.matrix("lin.weight", 1, H), file.row("lin.bias", 1)};
  if (file.has("input.mean") || file.has("input.std")) {
    m.input_mean = file.row("input.mean", F);
    m.input_std = file.row("input.std", F);
    if (!(m.input_std.minCoeff() > 0.0)) file.fail("input.std: a value is not positive");
  }
  if (file.has("output.mean") || file.has("output.std")) {
    m.output_mean = file.row("output.mean", 1)[0];
    m.output_std = file.row("output.std", 1)[0];
  }
  if (file.has("output.log")) m.logarithm = file.row("output.log", 1)[0] != 0.0;
  impl_ = std::move(impl);
}

GraphNetwork::~GraphNetwork() = default;
GraphNetwork::GraphNetwork(GraphNetwork&&) noexcept = default;
GraphNetwork& GraphNetwork::operator=(GraphNetwork&&) noexcept = default;

Index GraphNetwork::node_features() const {
  return impl_->encoder.weight.cols();
}
Index GraphNetwork::edge_features() const {
  return impl_->convolutions.front().mu.cols();
}
Index GraphNetwork::hidden() const {
  return impl_->encoder.weight.rows();
}
std::size_t GraphNetwork::convolutions() const {
  return impl_->convolutions.size();
}
double GraphNetwork::evaluate(const Input& input) const {
  return impl_->evaluate<double>(input);
}
float GraphNetwork::evaluate_single(const Input& input) const {
  return static_cast<float>(impl_->evaluate<float>(input));
}

// ---- the objective

namespace {

/// Types of edges: those of LAMP's messages minus one; a prior is a self loop.
enum EdgeType : std::uint8_t { kPrior = 0, kClosure = 2, kOdometry = 3 };
constexpr Index kEdgeTypes = 4;
constexpr Index kNodeFeatures = 7;

/// A change of the set, which affects the incoming candidate edges of a node.
struct Change {
  std::size_t candidate;
  bool enters;
};

}  // namespace

struct GnnObjective::Impl {
  using Row = Eigen::RowVectorXd;
  using Matrix = Layers<double>::Matrix;

  Impl(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates)
      : set(candidates.size()), parts(graph) {}

  std::shared_ptr<const GraphNetwork> network;
  Layers<double> layers;
  CandidateSet set;
  detail::GraphComponents parts;
  Eigen::MatrixXd features;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> ends;  // of the candidates
  std::uint8_t candidate_type = kClosure;

  struct Edge {
    std::uint32_t other;
    std::uint8_t type;
  };
  std::vector<std::vector<Edge>> incoming, outgoing;        // of the graph, by node
  std::vector<std::vector<std::uint32_t>> set_in, set_out;  // candidates in the set, by their `to` and `from`

  // h[l]: features after l layers for the current set; the last layer is without tanh.
  std::vector<Matrix> h;
  Row sum;
  std::optional<double> current;

  // Scratch memory of an evaluation: rows that differ from h[l].
  struct Changed {
    std::vector<std::uint32_t> nodes;
    Matrix rows;
    std::vector<std::int32_t> place;  // by node, −1 if unchanged
  };
  std::vector<Changed> changed;
  std::vector<Change> pending;

  /// The row of a node in h[l] with the pending changes.
  [[nodiscard]] Eigen::Map<const Row> row_after(std::size_t l, std::uint32_t node) const {
    const std::int32_t place = changed[l].place[node];
    const double* data = place < 0 ? h[l].row(node).data() : changed[l].rows.row(place).data();
    return {data, h[l].cols()};
  }

  [[nodiscard]] bool leaves(std::uint32_t candidate) const {
    return std::any_of(pending.begin(), pending.end(),
                       [&](const Change& c) { return !c.enters && c.candidate == candidate; });
  }

  /// Computes the row of a node in h[l + 1] from h[l], with the pending changes.
  void compute(std::size_t l, std::uint32_t node, Eigen::Ref<Row> out) const {
    const auto& layer = layers.layers[l];
    std::array<Row, kEdgeTypes>
        by_type;  // sources are summed by type first, so that one product per type is enough
    std::array<bool, kEdgeTypes> used{};
    int count = 0;
    const auto receive = [&](std::uint32_t from, std::uint8_t type) {
      ++count;
      if (used[type]) {
        by_type[type] += row_after(l, from);
      } else {
        by_type[type] = row_after(l, from);
        used[type] = true;
      }
    };
    for (const Edge& edge : incoming[node]) receive(edge.other, edge.type);
    for (const std::uint32_t candidate : set_in[node]) {
      if (!leaves(candidate)) receive(ends[candidate].first, candidate_type);
    }
    for (const Change& change : pending) {
      if (change.enters && ends[change.candidate].second == node) {
        receive(ends[change.candidate].first, candidate_type);
      }
    }
    out = layer.bias;
    out.noalias() += row_after(l, node) * layer.root;
    if (count > 0) {
      const double share = 1.0 / count;
      for (std::size_t type = 0; type < by_type.size(); ++type) {
        if (used[type]) out.noalias() += (share * by_type[type]) * layer.message[type];
      }
    }
    if (l + 1 < layers.layers.size()) out = out.array().tanh().matrix().eval();
  }

  void mark(std::size_t l, std::uint32_t node) {
    Changed& c = changed[l];
    if (c.place[node] >= 0) return;
    c.place[node] = static_cast<std::int32_t>(c.nodes.size());
    c.nodes.push_back(node);
  }

  /// Propagates the pending changes through all layers. \returns the resulting sum over nodes.
  [[nodiscard]] Row propagate() {
    Row after = sum;
    for (std::size_t l = 0; l < layers.layers.size(); ++l) {
      Changed& next = changed[l + 1];
      for (const Change& change : pending) mark(l + 1, ends[change.candidate].second);
      for (const std::uint32_t node : changed[l].nodes) {
        mark(l + 1, node);
        for (const Edge& edge : outgoing[node]) mark(l + 1, edge.other);
        for (const std::uint32_t candidate : set_out[node]) {
          if (!leaves(candidate)) mark(l + 1, ends[candidate].second);
        }
      }
      if (next.rows.rows() < static_cast<Index>(next.nodes.size())) {
        next.rows.resize(2 * static_cast<Index>(next.nodes.size()), h[l].cols());
      }
      for (std::size_t k = 0; k < next.nodes.size(); ++k) {
        compute(l, next.nodes[k], next.rows.row(static_cast<Index>(k)));
      }
    }
    const Changed& last = changed.back();
    for (std::size_t k = 0; k < last.nodes.size(); ++k) {
      after += last.rows.row(static_cast<Index>(k)) - h.back().row(last.nodes[k]);
    }
    return after;
  }

  void forget() {
    for (Changed& c : changed) {
      for (const std::uint32_t node : c.nodes) c.place[node] = -1;
      c.nodes.clear();
    }
    pending.clear();
  }

  [[nodiscard]] double value() {
    if (!current) current = network->impl_->head<double>(sum);
    return *current;
  }

  [[nodiscard]] double evaluate(std::vector<Change> changes) {
    pending = std::move(changes);
    const double after = network->impl_->head<double>(propagate());
    forget();
    return after - value();
  }

  void apply(std::vector<Change> changes) {
    pending = std::move(changes);
    (void)propagate();
    for (std::size_t l = 1; l < h.size(); ++l) {
      for (std::size_t k = 0; k < changed[l].nodes.size(); ++k) {
        h[l].row(changed[l].nodes[k]) = changed[l].rows.row(static_cast<Index>(k));
      }
    }
    for (const Change& change : pending) {
      const auto [from, to] = ends[change.candidate];
      const auto id = static_cast<std::uint32_t>(change.candidate);
      if (change.enters) {
        set_in[to].push_back(id);
        set_out[from].push_back(id);
      } else {
        set_in[to].erase(std::find(set_in[to].begin(), set_in[to].end(), id));
        set_out[from].erase(std::find(set_out[from].begin(), set_out[from].end(), id));
      }
    }
    forget();
    sum = h.back().colwise().sum();  // summed again, so that errors do not accumulate
    current.reset();
  }

  void compute_all() {
    for (std::size_t l = 0; l < layers.layers.size(); ++l) {
      for (Index i = 0; i < features.rows(); ++i) {
        compute(l, static_cast<std::uint32_t>(i), h[l + 1].row(i));
      }
    }
    sum = h.back().colwise().sum();
    current.reset();
  }
};

GraphNetwork::Input graph_input(const PoseGraph& graph, GnnFeatures features,
                                const std::vector<Matrix6d>& covariances) {
  const std::size_t n = graph.nodes().size();
  if (!covariances.empty() && covariances.size() != n) {
    throw InputError(std::to_string(covariances.size()) + " covariances, expected one for each of " +
                     std::to_string(n) + " nodes");
  }
  GraphNetwork::Input out;
  out.nodes.resize(static_cast<Index>(n), kNodeFeatures);
  for (std::size_t i = 0; i < n; ++i) {
    const Eigen::Isometry3d& pose = graph.nodes()[i].pose;
    Eigen::Vector3d variance = Eigen::Vector3d::Zero();
    if (!covariances.empty() && covariances[i].allFinite()) {
      variance = features == GnnFeatures::kLamp
                     ? Eigen::Vector3d(covariances[i].diagonal().tail<3>())
                     : Eigen::Vector3d(
                           (pose.linear() * covariances[i].topLeftCorner<3, 3>() * pose.linear().transpose())
                               .diagonal());
    }
    Eigen::Matrix<double, 1, kNodeFeatures> row;
    row << variance.transpose(), pose.translation().transpose(), 1.0;
    if (features == GnnFeatures::kLamp) row = row.cast<float>().cast<double>().eval();
    out.nodes.row(static_cast<Index>(i)) = row;
  }
  std::vector<std::uint8_t> types;
  const auto connect = [&](std::size_t from, std::size_t to, std::uint8_t type) {
    out.edges.emplace_back(static_cast<std::uint32_t>(from), static_cast<std::uint32_t>(to));
    types.push_back(type);
  };
  for (const PriorFactor& prior : graph.priors()) {
    const std::size_t node = graph.index_of(prior.key);
    connect(node, node, kPrior);
  }
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const ::loopwise::Edge& edge = graph.edges()[e];
    // Closures that the back end rejects are not edges. Odometry always is, even with a weight that the back
    // end has reduced.
    if (edge.kind != EdgeKind::kOdometry && !edge.trusted && edge.weight <= 0.5) continue;
    connect(graph.ends(e).from, graph.ends(e).to, edge.kind == EdgeKind::kOdometry ? kOdometry : kClosure);
  }
  out.edge_attributes = Eigen::MatrixXd::Zero(static_cast<Index>(types.size()), kEdgeTypes);
  for (std::size_t e = 0; e < types.size(); ++e) out.edge_attributes(static_cast<Index>(e), types[e]) = 1.0;
  return out;
}

GnnObjective::GnnObjective(const PoseGraph& graph, const std::vector<LoopCandidate>& candidates,
                           std::shared_ptr<const GraphNetwork> network, GnnFeatures features,
                           const std::vector<Matrix6d>& covariances) {
  if (!network) throw InputError("GnnObjective needs a network");
  if (network->node_features() != kNodeFeatures || network->edge_features() != kEdgeTypes) {
    throw InputError("the network takes " + std::to_string(network->node_features()) + " node and " +
                     std::to_string(network->edge_features()) + " edge features, expected 7 and 4");
  }
  const std::size_t n = graph.nodes().size();
  impl_ = std::make_unique<Impl>(graph, candidates);
  Impl& m = *impl_;
  m.network = std::move(network);
  m.layers = m.network->impl_->layers<double>(Eigen::MatrixXd::Identity(kEdgeTypes, kEdgeTypes));
  m.candidate_type = features == GnnFeatures::kLamp ? kOdometry : kClosure;

  const GraphNetwork::Input bare = graph_input(graph, features, covariances);
  m.features = bare.nodes;
  m.incoming.resize(n);
  m.outgoing.resize(n);
  m.set_in.resize(n);
  m.set_out.resize(n);
  for (std::size_t e = 0; e < bare.edges.size(); ++e) {
    const auto [from, to] = bare.edges[e];
    Index type = 0;
    bare.edge_attributes.row(static_cast<Index>(e)).maxCoeff(&type);
    m.incoming[to].push_back({from, static_cast<std::uint8_t>(type)});
    m.outgoing[from].push_back({to, static_cast<std::uint8_t>(type)});
  }
  for (const LoopCandidate& c : candidates) {
    m.ends.emplace_back(static_cast<std::uint32_t>(graph.index_of(c.from)),
                        static_cast<std::uint32_t>(graph.index_of(c.to)));
  }
  const auto hidden = m.network->hidden();
  m.h.assign(m.layers.layers.size() + 1, Impl::Matrix::Zero(static_cast<Index>(n), hidden));
  m.changed.resize(m.h.size());
  for (Impl::Changed& c : m.changed) c.place.assign(n, -1);
  m.h[0] = (m.network->impl_->normalized(m.features) * m.layers.encoder).rowwise() + m.layers.encoder_bias;
  m.compute_all();
}

GnnObjective::~GnnObjective() = default;

std::size_t GnnObjective::size() const {
  return impl_->ends.size();
}
const std::vector<std::size_t>& GnnObjective::selected() const {
  return impl_->set.members();
}
bool GnnObjective::contains(std::size_t candidate) const {
  return impl_->set.contains(candidate);
}
bool GnnObjective::connecting(std::size_t candidate) const {
  return impl_->parts.connecting(impl_->ends[candidate].first, impl_->ends[candidate].second);
}
double GnnObjective::value() {
  return impl_->value();
}
double GnnObjective::add_change(std::size_t candidate) {
  return impl_->evaluate({{candidate, true}});
}
double GnnObjective::remove_change(std::size_t candidate) {
  return impl_->evaluate({{candidate, false}});
}
double GnnObjective::swap_change(std::size_t out, std::size_t in) {
  return impl_->evaluate({{out, false}, {in, true}});
}
std::vector<double> GnnObjective::add_changes() {
  std::vector<double> out(size(), 0.0);
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (!contains(i)) out[i] = add_change(i);
  }
  return out;
}

void GnnObjective::assign(const std::vector<std::size_t>& set) {
  Impl& m = *impl_;
  m.set.assign(set);
  for (auto& list : m.set_in) list.clear();
  for (auto& list : m.set_out) list.clear();
  for (const std::size_t candidate : set) {
    m.set_in[m.ends[candidate].second].push_back(static_cast<std::uint32_t>(candidate));
    m.set_out[m.ends[candidate].first].push_back(static_cast<std::uint32_t>(candidate));
  }
  m.compute_all();
}

void GnnObjective::add(std::size_t candidate) {
  impl_->apply({{candidate, true}});
  impl_->set.add(candidate);
}
void GnnObjective::remove(std::size_t candidate) {
  impl_->apply({{candidate, false}});
  impl_->set.remove(candidate);
}
void GnnObjective::swap(std::size_t out, std::size_t in) {
  impl_->apply({{out, false}, {in, true}});
  impl_->set.swap(out, in);
}

GraphNetwork::Input GnnObjective::input() const {
  const Impl& m = *impl_;
  GraphNetwork::Input out;
  out.nodes = m.features;
  std::vector<std::uint8_t> types;
  for (std::size_t to = 0; to < m.incoming.size(); ++to) {
    for (const auto& edge : m.incoming[to]) {
      out.edges.emplace_back(edge.other, static_cast<std::uint32_t>(to));
      types.push_back(edge.type);
    }
  }
  for (const std::size_t candidate : m.set.members()) {
    out.edges.push_back(m.ends[candidate]);
    types.push_back(m.candidate_type);
  }
  out.edge_attributes = Eigen::MatrixXd::Zero(static_cast<Index>(types.size()), kEdgeTypes);
  for (std::size_t e = 0; e < types.size(); ++e) out.edge_attributes(static_cast<Index>(e), types[e]) = 1.0;
  return out;
}

}  // namespace loopwise
