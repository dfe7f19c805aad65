// SPDX-License-Identifier: BSD-3-Clause
#include "trainer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

// Included before libtorch, which defines macros.
#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>

#include "linalg/blas_threads.hpp"
#include "packed.hpp"

#include "network_tensors.hpp"

namespace loopwise::training {
namespace {

constexpr int kVersion = 1;
/// For the paper's network: graphs of a step, and sets of each graph.
constexpr std::size_t kGraphsOfStep = 8;
constexpr std::size_t kSetsOfStep = 4;
/// Rounds of an epoch; each uses all graphs, with different sets.
constexpr std::size_t kRounds = 4;

bool is_buffer(const std::string& name) {
  return name.find("running_") != std::string::npos || name.find(".mean") != std::string::npos ||
         name.find(".std") != std::string::npos || name == "output.log";
}

// ---- weights

PlainTensor to_plain(const torch::Tensor& t) {
  const torch::Tensor flat = t.detach().to(torch::kFloat32).contiguous();
  PlainTensor out;
  out.shape = t.sizes().vec();
  out.data.assign(flat.data_ptr<float>(), flat.data_ptr<float>() + flat.numel());
  return out;
}

torch::Tensor from_plain(const PlainTensor& t, torch::ScalarType type) {
  return torch::tensor(t.data, torch::kFloat32).view(t.shape).to(type);
}

torch::Tensor draw(const std::vector<std::int64_t>& shape, double bound, Rng& rng) {
  std::int64_t count = 1;
  for (const std::int64_t s : shape) count *= s;
  std::vector<float> values(static_cast<std::size_t>(count));
  for (float& v : values) v = static_cast<float>(rng.uniform(-bound, bound));
  return torch::tensor(values, torch::kFloat32).view(shape);
}

TensorMap first_loopwise(const FitOptions& options, Rng& rng) {
  const std::int64_t H = options.hidden, K = options.channels, C = K + kFixed, X = 3 * C + kUnit;
  TensorMap w;
  const auto layer = [&](const std::string& name, std::int64_t out, std::int64_t in, double scale) {
    const double bound = scale * std::sqrt(3.0 / static_cast<double>(in));
    w[name + ".weight"] = draw({out, in}, bound, rng);
    w[name + ".bias"] = torch::zeros({out});
  };
  layer("message.0", 16, kEdge, 1.0);
  layer("message.1", K, 16, 0.5);
  w["message.skip.weight"] = draw({K, kEdge}, 0.5, rng);
  layer("readout.0", H, X, 1.0);
  layer("readout.1", H, H, 1.0);
  layer("readout.2", 2, H, 0.1);
  return w;
}

TensorMap first_paper(const FitOptions& options, Rng& rng) {
  const std::int64_t H = options.hidden, K = options.kernels;
  TensorMap w;
  const auto layer = [&](const std::string& name, std::int64_t out, std::int64_t in) {
    const double bound = 1.0 / std::sqrt(static_cast<double>(in));
    w[name + ".weight"] = draw({out, in}, bound, rng);
    w[name + ".bias"] = draw({out}, bound, rng);
  };
  layer("node_encoder", H, kNodeFeatures);
  for (std::int64_t l = 0; l < kConvolutions; ++l) {
    const std::string name = l == 0 ? "conv1" : "gcs." + std::to_string(l - 1);
    const double bound = std::sqrt(6.0 / static_cast<double>(2 * H));
    w[name + ".g"] = draw({H, K * H}, bound, rng);
    w[name + ".mu"] = draw({K, kEdgeTypes}, 0.5, rng) + 0.5;
    w[name + ".sigma"] = draw({K, kEdgeTypes}, 0.2, rng) + 0.8;
    w[name + ".root"] = draw({H, H}, bound, rng);
    w[name + ".bias"] = torch::zeros({H});
  }
  for (std::int64_t l = 0; l < kDense; ++l) layer("lins." + std::to_string(l), H, H);
  for (std::int64_t l = 1; l <= kDense + 1; ++l) {
    const std::string name = "batch_norms." + std::to_string(l);
    w[name + ".weight"] = torch::ones({H});
    w[name + ".bias"] = torch::zeros({H});
    w[name + ".running_mean"] = torch::zeros({H});
    w[name + ".running_var"] = torch::ones({H});
  }
  layer("lin", 1, H);
  return w;
}

/// Mean and standard deviation; 0 and 1 if the values do not vary.
class Statistics {
 public:
  explicit Statistics(Eigen::Index size) : sum_(Eigen::VectorXd::Zero(size)), squares_(sum_) {}
  void add(const Eigen::VectorXd& value) {
    sum_ += value;
    squares_ += value.cwiseAbs2();
    count_ += 1.0;
  }
  [[nodiscard]] std::pair<torch::Tensor, torch::Tensor> mean_and_std(
      const std::vector<bool>& kept = {}) const {
    std::vector<float> mean, deviation;
    for (Eigen::Index i = 0; i < sum_.size(); ++i) {
      const double m = sum_[i] / std::max(1.0, count_);
      const double s = std::sqrt(std::max(0.0, squares_[i] / std::max(1.0, count_) - m * m));
      const bool plain =
          (!kept.empty() && kept[static_cast<std::size_t>(i)]) || !(s > 1e-9 * (1.0 + std::abs(m)));
      mean.push_back(plain ? 0.0F : static_cast<float>(m));
      deviation.push_back(plain ? 1.0F : static_cast<float>(s));
    }
    return {torch::tensor(mean), torch::tensor(deviation)};
  }

 private:
  Eigen::VectorXd sum_, squares_;
  double count_ = 0.0;
};

void add_statistics(TensorMap& w, const std::vector<MissionData>& missions, const FitOptions& options) {
  if (options.network == NetworkKind::kLoopwise) {
    Statistics edges(kEdge), units(kUnit);
    for (const MissionData& mission : missions) {
      for (const TrainingGraph& graph : mission.graphs) {
        for (Eigen::Index c = 0; c < graph.effects.candidates(); ++c) {
          const Eigen::MatrixXd features = graph.effects.edge_features(c);
          for (Eigen::Index u = 0; u < features.rows(); ++u) edges.add(features.row(u).transpose());
        }
        for (Eigen::Index u = 0; u < graph.effects.unit_count(); ++u) {
          units.add(graph.effects.units.row(u).transpose());
        }
      }
    }
    std::tie(w["edge.mean"], w["edge.std"]) =
        edges.mean_and_std({false, true, true, true, true, false, false, false, false});
    std::tie(w["unit.mean"], w["unit.std"]) = units.mean_and_std({false, false, true, true, false});
    return;
  }
  Statistics nodes(kNodeFeatures), output(1);
  for (const MissionData& mission : missions) {
    for (const TrainingGraph& graph : mission.graphs) {
      for (Eigen::Index i = 0; i < graph.input.nodes.rows(); ++i)
        nodes.add(graph.input.nodes.row(i).transpose());
      for (const TrainingSet& set : graph.sets) {
        output.add(Eigen::VectorXd::Constant(
            1, options.target == Target::kLog ? std::log(set.trace_m2) : set.trace_m2));
      }
    }
  }
  std::tie(w["input.mean"], w["input.std"]) = nodes.mean_and_std();
  std::tie(w["output.mean"], w["output.std"]) = output.mean_and_std();
  w["output.log"] = torch::full({1}, options.target == Target::kLog ? 1.0F : 0.0F);
}

std::string data_hash(const std::vector<MissionData>& training, const std::vector<MissionData>& validation) {
  ContentHasher hasher;
  for (const auto* missions : {&training, &validation}) {
    hasher.integer(missions->size());
    for (const MissionData& mission : *missions) {
      const ContentHash whole = hash_of(mission);
      hasher.integer(whole.high).integer(whole.low);
    }
  }
  return to_string(hasher.finish());
}

FitOptions resolved(FitOptions options) {
  validate(options);
  if (options.hidden == 0) options.hidden = options.network == NetworkKind::kLoopwise ? 24 : 64;
  return options;
}

}  // namespace

struct Trainer::Impl {
  detail::SingleThreadedBlas one_thread;
  FitOptions options;
  std::vector<MissionData> training, validation;
  std::string hash;
  TensorMap weights, first_moment, second_moment, best;
  std::int64_t step = 0;
  double best_loss = std::numeric_limits<double>::infinity();
  std::vector<EpochResult> history;
  std::vector<EffectBatch> training_batches, validation_batches;

  [[nodiscard]] std::vector<const TrainingGraph*> graphs(const std::vector<MissionData>& missions) const {
    std::vector<const TrainingGraph*> out;
    for (const MissionData& mission : missions) {
      for (const TrainingGraph& graph : mission.graphs) out.push_back(&graph);
    }
    return out;
  }

  void require_gradients() {
    for (auto& [name, tensor] : weights) {
      if (!is_buffer(name)) tensor.requires_grad_(true);
    }
  }

  void keep_best() {
    best.clear();
    for (const auto& [name, tensor] : weights) best[name] = tensor.detach().clone();
  }

  /// Adam (Kingma, Ba 2015).
  void descend(double rate) {
    const torch::NoGradGuard no_gradients;
    ++step;
    const double one = 1.0 - std::pow(0.9, static_cast<double>(step));
    const double two = 1.0 - std::pow(0.999, static_cast<double>(step));
    double norm = 0.0;
    for (const auto& [name, tensor] : weights) {
      if (tensor.grad().defined()) norm += tensor.grad().pow(2).sum().item<double>();
    }
    const double scale =
        std::min(1.0, 1.0 / (std::sqrt(norm) + 1e-12));  // limits the norm of the gradient to 1
    for (auto& [name, tensor] : weights) {
      if (!tensor.grad().defined()) continue;
      const torch::Tensor g = tensor.grad() * scale;
      torch::Tensor &m = first_moment[name], &v = second_moment[name];
      m.mul_(0.9).add_(g, 0.1);
      v.mul_(0.999).addcmul_(g, g, 0.001);
      tensor.sub_(rate * (m / one) / ((v / two).sqrt() + 1e-8));
      tensor.mutable_grad() = torch::Tensor();
    }
  }

  [[nodiscard]] PaperBatch validation_batch(const TrainingGraph& graph, std::int64_t group) const {
    std::vector<PaperSample> samples;
    const std::size_t every = std::max<std::size_t>(1, graph.sets.size() / 16);
    for (std::size_t s = 0; s < graph.sets.size(); s += every)
      samples.push_back({&graph, &graph.sets[s], group});
    return paper_batch(samples, torch::kFloat32);
  }

  [[nodiscard]] double validate_now() const {
    const torch::NoGradGuard no_gradients;
    double sum = 0.0;
    if (options.network == NetworkKind::kLoopwise) {
      for (const EffectBatch& batch : validation_batches) sum += effect_loss(weights, batch).item<double>();
      return sum / static_cast<double>(validation_batches.size());
    }
    const auto all = graphs(validation);
    for (std::size_t g = 0; g < all.size(); ++g) {
      sum += paper_loss(weights, validation_batch(*all[g], static_cast<std::int64_t>(g)), false,
                        options.target == Target::kLog)
                 .item<double>();
    }
    return sum / static_cast<double>(all.size());
  }
};

Trainer::Trainer(const std::vector<MissionData>& training, const std::vector<MissionData>& validation,
                 const FitOptions& options)
    : impl_(std::make_unique<Impl>()) {
  Impl& m = *impl_;
  m.options = resolved(options);
  m.training = training;
  m.validation = validation;
  if (m.graphs(training).empty()) throw InputError("no missions to train with");
  if (m.graphs(validation).empty()) throw InputError("no missions to validate with");
  at::set_num_threads(1);
  m.hash = data_hash(training, validation);
  Rng rng(combine_seeds(m.options.seed, 0x6e6574));
  m.weights = m.options.network == NetworkKind::kLoopwise ? first_loopwise(m.options, rng)
                                                          : first_paper(m.options, rng);
  add_statistics(m.weights, training, m.options);
  m.keep_best();
  for (const auto& [name, tensor] : m.weights) {
    if (is_buffer(name)) continue;
    m.first_moment[name] = torch::zeros_like(tensor);
    m.second_moment[name] = torch::zeros_like(tensor);
  }
  m.require_gradients();
  if (m.options.network == NetworkKind::kLoopwise) {
    for (const TrainingGraph* g : m.graphs(training))
      m.training_batches.push_back(effect_batch(*g, torch::kFloat32));
    for (const TrainingGraph* g : m.graphs(validation)) {
      m.validation_batches.push_back(effect_batch(*g, torch::kFloat32));
    }
  }
}

Trainer::~Trainer() = default;

bool Trainer::done() const {
  const auto& history = impl_->history;
  if (static_cast<std::int64_t>(history.size()) >= impl_->options.epochs) return true;
  std::int64_t since = 0;
  for (const EpochResult& epoch : history) since = epoch.best ? 0 : since + 1;
  return since >= impl_->options.patience;
}

const std::vector<EpochResult>& Trainer::history() const {
  return impl_->history;
}

std::optional<EpochResult> Trainer::run_epoch(const StopToken& stop, const ProgressCallback& progress) {
  Impl& m = *impl_;
  EpochResult result;
  result.epoch = static_cast<std::int64_t>(m.history.size()) + 1;
  Rng rng(
      combine_seeds(combine_seeds(m.options.seed, 0x65706f6368), static_cast<std::uint64_t>(result.epoch)));
  const double turn = static_cast<double>(result.epoch - 1) / static_cast<double>(m.options.epochs);
  const double rate =
      m.options.learning_rate * (0.05 + 0.95 * 0.5 * (1.0 + std::cos(turn * 3.141592653589793)));
  const auto all = m.graphs(m.training);
  std::vector<std::size_t> order;
  const bool paper = m.options.network == NetworkKind::kPaper;
  for (std::size_t round = 0; round < (paper ? kRounds : 1); ++round) {
    std::vector<std::size_t> once(all.size());
    std::iota(once.begin(), once.end(), std::size_t{0});
    rng.shuffle(once);
    order.insert(order.end(), once.begin(), once.end());
  }
  const std::size_t width = paper ? kGraphsOfStep : 1;
  const std::size_t steps = (order.size() + width - 1) / width;
  double sum = 0.0;
  for (std::size_t s = 0; s < steps; ++s) {
    if (stop.stop_requested()) return std::nullopt;
    if (progress) progress({"epoch " + std::to_string(result.epoch), s, steps, ""});
    torch::Tensor loss;
    if (paper) {
      std::vector<PaperSample> samples;
      for (std::size_t k = 0; k < width; ++k) {
        const TrainingGraph& graph = *all[order[(s * width + k) % order.size()]];
        for (std::size_t j = 0; j < kSetsOfStep; ++j) {
          samples.push_back(
              {&graph, &graph.sets[rng.below(graph.sets.size())], static_cast<std::int64_t>(k)});
        }
      }
      loss = paper_loss(m.weights, paper_batch(samples, torch::kFloat32), true,
                        m.options.target == Target::kLog);
    } else {
      loss = effect_loss(m.weights, m.training_batches[order[s]]);
    }
    const double value = loss.item<double>();
    if (!std::isfinite(value)) {
      throw Error("the loss is no longer finite in epoch " + std::to_string(result.epoch) +
                  ": a smaller learning rate may help");
    }
    sum += value;
    loss.backward();
    m.descend(rate);
  }
  result.training_loss = sum / static_cast<double>(steps);
  result.validation_loss = m.validate_now();
  if (!std::isfinite(result.validation_loss)) throw Error("the validation loss is not finite");
  result.best = result.validation_loss < m.best_loss;
  if (result.best) {
    m.best_loss = result.validation_loss;
    m.keep_best();
  }
  m.history.push_back(result);
  return result;
}

Tensors Trainer::weights() const {
  Tensors out;
  for (const auto& [name, tensor] : impl_->best) out[name] = to_plain(tensor);
  return out;
}

double Trainer::gradient_error(std::size_t samples, std::uint64_t seed) {
  Impl& m = *impl_;
  TensorMap w;
  for (const auto& [name, tensor] : m.weights) {
    w[name] = tensor.detach().to(torch::kFloat64);
    if (!is_buffer(name)) w[name].requires_grad_(true);
  }
  const auto all = m.graphs(m.training);
  const bool paper = m.options.network == NetworkKind::kPaper;
  EffectBatch effects;
  PaperBatch graphs;
  if (paper) {
    std::vector<PaperSample> chosen;
    for (std::size_t g = 0; g < all.size(); ++g) {
      for (std::size_t s = 0; s < std::min<std::size_t>(3, all[g]->sets.size()); ++s) {
        chosen.push_back({all[g], &all[g]->sets[s], static_cast<std::int64_t>(g)});
      }
    }
    graphs = paper_batch(chosen, torch::kFloat64);
  } else {
    effects = effect_batch(*all.front(), torch::kFloat64);
  }
  const auto loss = [&] {
    // Inference mode of the batch normalisation: its running statistics do not change.
    return paper ? paper_loss(w, graphs, false, m.options.target == Target::kLog) : effect_loss(w, effects);
  };
  loss().backward();
  Rng rng(seed);
  std::vector<std::string> names;
  for (const auto& [name, tensor] : w) {
    if (!is_buffer(name)) names.push_back(name);
  }
  double largest = 0.0, worst = 0.0;
  for (const std::string& name : names)
    largest = std::max(largest, w[name].grad().abs().max().item<double>());
  const torch::NoGradGuard no_gradients;
  for (std::size_t k = 0; k < samples; ++k) {
    torch::Tensor& tensor = w[names[rng.below(names.size())]];
    const auto at = static_cast<std::int64_t>(rng.below(static_cast<std::uint64_t>(tensor.numel())));
    double* value = tensor.data_ptr<double>() + at;
    const double kept = *value, h = 1e-5;
    *value = kept + h;
    const double above_ = loss().item<double>();
    *value = kept - h;
    const double below_ = loss().item<double>();
    *value = kept;
    const double slope = (above_ - below_) / (2.0 * h);
    worst = std::max(worst, std::abs(slope - tensor.grad().contiguous().data_ptr<double>()[at]));
  }
  return worst / largest;
}

// ---- files

namespace {

nlohmann::json pack_map(const TensorMap& map) {
  nlohmann::json out = nlohmann::json::object();
  for (const auto& [name, tensor] : map) out[name] = pack(to_plain(tensor).data);
  return out;
}

void unpack_map(const Field& field, const TensorMap& like, TensorMap& out) {
  const torch::NoGradGuard no_gradients;
  for (const auto& [name, tensor] : like) {
    const auto values = field[name].values<float>(static_cast<std::size_t>(tensor.numel()));
    out[name] = torch::tensor(values, torch::kFloat32).view(tensor.sizes());
  }
}

std::string fixed_options(FitOptions options) {
  options.epochs = options.patience = 1;
  return to_json(options).dump();
}

}  // namespace

void Trainer::save(const std::filesystem::path& checkpoint) const {
  const Impl& m = *impl_;
  std::vector<double> losses;
  std::vector<std::uint8_t> best;
  for (const EpochResult& epoch : m.history) {
    losses.push_back(epoch.training_loss);
    losses.push_back(epoch.validation_loss);
    best.push_back(epoch.best ? 1 : 0);
  }
  write_packed(checkpoint, {{"format", "loopwise-train-checkpoint"},
                            {"version", kVersion},
                            {"options", fixed_options(m.options)},
                            {"epochs", m.options.epochs},
                            {"data", m.hash},
                            {"step", m.step},
                            {"losses", pack(losses)},
                            {"best_epochs", pack(best)},
                            {"weights", pack_map(m.weights)},
                            {"first_moment", pack_map(m.first_moment)},
                            {"second_moment", pack_map(m.second_moment)},
                            {"best", pack_map(m.best)}});
}

void Trainer::load(const std::filesystem::path& checkpoint) {
  Impl& m = *impl_;
  const nlohmann::json all = read_packed(checkpoint, "loopwise-train-checkpoint", kVersion);
  const Field field(checkpoint.string(), all);
  if (field["data"].text() != m.hash) field["data"].fail("the checkpoint is of another data set or split");
  if (field["options"].text() != fixed_options(m.options)) {
    field["options"].fail("trained with " + field["options"].text() + ", now " + fixed_options(m.options));
  }
  if (static_cast<std::int64_t>(field["epochs"].integer()) != m.options.epochs) {
    field["epochs"].fail("the schedule of the learning rate is for " +
                         std::to_string(field["epochs"].integer()) + " epochs, not " +
                         std::to_string(m.options.epochs));
  }
  m.step = static_cast<std::int64_t>(field["step"].integer());
  const auto best = field["best_epochs"].values<std::uint8_t>();
  const auto losses = field["losses"].values<double>(2 * best.size());
  m.history.clear();
  m.best_loss = std::numeric_limits<double>::infinity();
  for (std::size_t e = 0; e < best.size(); ++e) {
    m.history.push_back({static_cast<std::int64_t>(e) + 1, losses[2 * e], losses[2 * e + 1], best[e] != 0});
    if (best[e] != 0) m.best_loss = losses[2 * e + 1];
  }
  const TensorMap like = m.weights, moments = m.first_moment;
  unpack_map(field["weights"], like, m.weights);
  unpack_map(field["first_moment"], moments, m.first_moment);
  unpack_map(field["second_moment"], moments, m.second_moment);
  unpack_map(field["best"], like, m.best);
  m.require_gradients();
}

double torch_evaluate(NetworkKind kind, const Tensors& tensors, const TrainingGraph& graph,
                      const std::vector<std::uint32_t>& set) {
  const torch::NoGradGuard no_gradients;
  const detail::SingleThreadedBlas one_thread;
  TensorMap w;
  for (const auto& [name, tensor] : tensors) w[name] = from_plain(tensor, torch::kFloat64);
  TrainingSet wanted;
  wanted.members = set;
  wanted.trace_m2 = 1.0;
  wanted.log_reduction = Eigen::VectorXf::Zero(graph.effects.unit_count());
  if (kind == NetworkKind::kLoopwise) {
    TrainingGraph alone = graph;
    alone.sets = {wanted};
    const EffectBatch batch = effect_batch(alone, torch::kFloat64);
    return batch.trace_m2 * std::exp(effect_forward(w, batch).second[0].item<double>());
  }
  const PaperBatch batch = paper_batch({{&graph, &wanted, 0}}, torch::kFloat64);
  const torch::Tensor y = paper_forward(w, batch, false) * w.at("output.std") + w.at("output.mean");
  const double out = y[0].item<double>();
  return w.at("output.log")[0].item<double>() != 0.0 ? std::exp(out) : out;
}

}  // namespace loopwise::training
