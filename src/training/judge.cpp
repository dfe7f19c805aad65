// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/training/judge.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <numeric>
#include <set>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/evaluation/sample_statistics.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/optimization/marginals.hpp>
#include <loopwise/prioritization/selection.hpp>

namespace loopwise::training {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::vector<double> ranks(const std::vector<double>& values) {
  std::vector<std::size_t> order(values.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  std::vector<double> out(values.size());
  for (std::size_t first = 0; first < order.size();) {
    std::size_t end = first;
    while (end < order.size() && values[order[end]] == values[order[first]]) ++end;
    for (std::size_t k = first; k < end; ++k) out[order[k]] = 0.5 * static_cast<double>(first + end - 1);
    first = end;
  }
  return out;
}

/// The exact objective with an observer. It records the set and the change for some of the swaps that
/// annealing evaluates.
class WatchedObjective final : public GraphObjective {
 public:
  struct Swap {
    std::vector<std::size_t> set;
    std::size_t out, in;
    double change;
  };
  WatchedObjective(GraphObjective& objective, std::size_t skip, std::size_t every)
      : objective_(objective), skip_(skip), every_(std::max<std::size_t>(1, every)) {}

  [[nodiscard]] const std::vector<Swap>& swaps() const { return swaps_; }

  [[nodiscard]] std::string_view name() const override { return objective_.name(); }
  [[nodiscard]] std::size_t size() const override { return objective_.size(); }
  [[nodiscard]] const std::vector<std::size_t>& selected() const override { return objective_.selected(); }
  [[nodiscard]] bool contains(std::size_t c) const override { return objective_.contains(c); }
  [[nodiscard]] double value() override { return objective_.value(); }
  [[nodiscard]] double add_change(std::size_t c) override { return objective_.add_change(c); }
  [[nodiscard]] double remove_change(std::size_t c) override { return objective_.remove_change(c); }
  [[nodiscard]] double swap_change(std::size_t out, std::size_t in) override {
    const double change = objective_.swap_change(out, in);
    if (asked_ >= skip_ && (asked_ - skip_) % every_ == 0) {
      swaps_.push_back({objective_.selected(), out, in, change});
    }
    ++asked_;
    return change;
  }
  [[nodiscard]] std::vector<double> add_changes() override { return objective_.add_changes(); }
  void assign(const std::vector<std::size_t>& set) override { objective_.assign(set); }
  void add(std::size_t c) override { objective_.add(c); }
  void remove(std::size_t c) override { objective_.remove(c); }
  void swap(std::size_t out, std::size_t in) override { objective_.swap(out, in); }
  [[nodiscard]] bool connecting(std::size_t c) const override { return objective_.connecting(c); }

 private:
  GraphObjective& objective_;
  std::size_t skip_, every_, asked_ = 0;
  std::vector<Swap> swaps_;
};

/// A method that predicts the value of a set.
struct Predictor {
  std::string name;
  std::function<double(const std::vector<std::size_t>&)> value;
  std::function<double(const WatchedObjective::Swap&)> change;
  std::function<std::vector<std::size_t>(std::size_t)> choose;
  bool calibrated = true;  ///< Whether the value is an estimate of the trace.
};

std::vector<std::vector<std::size_t>> random_sets(std::size_t candidates, std::size_t most, bool mixed,
                                                  std::size_t count, Rng& rng) {
  std::vector<std::size_t> all(candidates);
  std::iota(all.begin(), all.end(), std::size_t{0});
  std::vector<std::vector<std::size_t>> out;
  for (std::size_t k = 0; k < count; ++k) {
    rng.shuffle(all);
    const std::size_t size = mixed ? rng.below(most + 1) : most;
    out.emplace_back(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(size));
  }
  return out;
}

std::vector<std::size_t> anneal(GraphObjective& objective, const std::vector<Eigen::Vector3d>& midpoints,
                                std::size_t count, const JudgeOptions& options) {
  SimulatedAnnealing annealing(objective, midpoints, count, {}, options.seed);
  annealing.run(static_cast<std::uint64_t>(options.evaluations));
  return annealing.best().set;
}

/// A graph for the comparison, with its exact objective and all compared methods.
struct Trial {
  Trial(const MissionRecord& record, std::size_t number, const std::vector<Judged>& networks,
        const JudgeOptions& how)
      : options(how),
        stage(stage_graph(record, stages()[number], static_cast<std::size_t>(options.candidates),
                          combine_seeds(combine_seeds(options.seed, 0x6a756467), number))),
        midpoints(candidate_midpoints(stage.graph, stage.candidates)),
        covariances(marginals(stage.graph).covariances),
        exact(stage.graph, stage.candidates),
        none(exact.value()),
        gains(exact.add_changes()) {
    for (const Judged& network : networks) predictors.push_back(predictor_of(network));
    predictors.push_back(additive());
  }
  Trial(const Trial&) = delete;
  Trial& operator=(const Trial&) = delete;

  [[nodiscard]] double truth_of(const std::vector<std::size_t>& set) {
    exact.assign(set);
    return exact.value();
  }

  const JudgeOptions& options;
  StageGraph stage;
  std::vector<Eigen::Vector3d> midpoints;
  std::vector<Matrix6d> covariances;
  CovarianceObjective exact;
  double none;  ///< Exact trace without closures.
  std::vector<double> gains;
  std::vector<std::unique_ptr<GraphObjective>> objectives;
  std::vector<Predictor> predictors;

 private:
  [[nodiscard]] Predictor predictor_of(const Judged& network) {
    if (network.loopwise) {
      const ClosureModelOptions closures;
      objectives.push_back(std::make_unique<EffectObjective>(stage.graph, stage.candidates, network.loopwise,
                                                             closures, closure_model(closures)));
    } else {
      objectives.push_back(std::make_unique<GnnObjective>(stage.graph, stage.candidates, network.paper,
                                                          network.features, covariances));
    }
    GraphObjective* objective = objectives.back().get();
    Predictor p;
    p.name = network.name;
    p.value = [objective](const std::vector<std::size_t>& set) {
      objective->assign(set);
      return objective->value();
    };
    p.change = [objective](const WatchedObjective::Swap& swap) {
      objective->assign(swap.set);
      return objective->swap_change(swap.out, swap.in);
    };
    p.choose = [this, objective](std::size_t count) { return anneal(*objective, midpoints, count, options); };
    return p;
  }

  /// Predicts the sum of the exact gains of the single closures.
  [[nodiscard]] Predictor additive() const {
    Predictor p;
    p.name = "additive";
    p.calibrated = false;
    p.value = [this](const std::vector<std::size_t>& set) {
      double sum = none;
      for (const std::size_t c : set) sum += gains[c];
      return sum;
    };
    p.change = [this](const WatchedObjective::Swap& swap) { return gains[swap.in] - gains[swap.out]; };
    p.choose = [this](std::size_t count) {
      std::vector<std::size_t> order(gains.size());
      std::iota(order.begin(), order.end(), std::size_t{0});
      std::stable_sort(order.begin(), order.end(),
                       [&](std::size_t a, std::size_t b) { return gains[a] < gains[b]; });
      order.resize(count);
      return order;
    };
    return p;
  }
};

/// Random sets of a graph with their exact traces, and swaps of a run of exact annealing.
struct Questions {
  Questions(Trial& trial, std::size_t B, Rng rng) {
    const std::size_t candidates = trial.stage.candidates.size();
    const auto count = static_cast<std::size_t>(trial.options.sets);
    mixed = random_sets(candidates, B, true, count, rng);
    fixed = random_sets(candidates, B, false, count, rng);
    for (const auto& set : mixed) mixed_truth.push_back(trial.truth_of(set));
    for (const auto& set : fixed) fixed_truth.push_back(trial.truth_of(set));
    const std::size_t scale = static_cast<std::size_t>(AnnealingOptions().scale_samples);
    const auto steps = static_cast<std::size_t>(trial.options.evaluations);
    WatchedObjective watched(
        trial.exact, std::min(scale, steps / 2),
        (steps - std::min(scale, steps / 2)) / static_cast<std::size_t>(trial.options.swaps));
    annealed = anneal(watched, trial.midpoints, B, trial.options);
    swaps = watched.swaps();
  }

  std::vector<std::vector<std::size_t>> mixed, fixed;
  std::vector<double> mixed_truth, fixed_truth;
  std::vector<std::size_t> annealed;
  std::vector<WatchedObjective::Swap> swaps;
};

/// Compares a predictor with the exact answers. \param j contains graph and size of the sets
Judgement judge_predictor(Trial& trial, const Questions& asked, const Predictor& p, Judgement j) {
  j.method = p.name;
  std::vector<double> values, errors;
  for (std::size_t k = 0; k < asked.mixed.size(); ++k) {
    values.push_back(p.value(asked.mixed[k]));
    if (p.calibrated && values.back() > 0.0)
      errors.push_back(std::abs(std::log(values.back() / asked.mixed_truth[k])));
  }
  j.log_error = errors.size() == asked.mixed.size() ? quantile(errors, 0.5) : kNaN;
  const auto correlation = [](double rho) { return std::isnan(rho) ? 0.0 : rho; };
  j.spearman_mixed = correlation(spearman(values, asked.mixed_truth));
  values.clear();
  for (const auto& set : asked.fixed) values.push_back(p.value(set));
  j.spearman_fixed = correlation(spearman(values, asked.fixed_truth));
  double right = 0.0, count = 0.0;
  for (const WatchedObjective::Swap& swap : asked.swaps) {
    if (swap.change == 0.0) continue;
    count += 1.0;
    if ((p.change(swap) < 0.0) == (swap.change < 0.0)) right += 1.0;
  }
  j.signs = count > 0.0 ? right / count : kNaN;
  j.chosen = trial.truth_of(p.choose(j.set_size)) / trial.none;
  return j;
}

/// Judges all methods with sets of one size.
void judge_size(Trial& trial, const Judgement& base, Rng rng, std::vector<Judgement>& out) {
  const std::size_t B = base.set_size;
  const Questions asked(trial, B, rng);
  for (const Predictor& p : trial.predictors) out.push_back(judge_predictor(trial, asked, p, base));
  const auto chose = [&](const std::string& method, const std::vector<std::size_t>& set) {
    Judgement j = base;
    j.method = method;
    j.log_error = j.spearman_mixed = j.spearman_fixed = j.signs = kNaN;
    j.chosen = trial.truth_of(set) / trial.none;
    out.push_back(j);
  };
  chose("exact annealing", asked.annealed);
  chose("exact greedy", greedy(trial.exact, trial.midpoints, B).set);
  chose("separated", farthest_points(trial.midpoints, B));
  double random = 0.0;
  for (const double trace : asked.fixed_truth) {
    random += trace / trial.none / static_cast<double>(asked.fixed_truth.size());
  }
  chose("random", asked.fixed.front());
  out.back().chosen = random;
}

}  // namespace

double spearman(const std::vector<double>& a, const std::vector<double>& b) {
  if (a.size() != b.size() || a.size() < 3) return kNaN;
  const std::vector<double> x = ranks(a), y = ranks(b);
  const double mean = 0.5 * static_cast<double>(a.size() - 1);
  double xy = 0.0, xx = 0.0, yy = 0.0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    xy += (x[i] - mean) * (y[i] - mean);
    xx += (x[i] - mean) * (x[i] - mean);
    yy += (y[i] - mean) * (y[i] - mean);
  }
  return xx > 0.0 && yy > 0.0 ? xy / std::sqrt(xx * yy) : kNaN;
}

Judged read_judged(const std::string& argument) {
  Judged out;
  std::string file = argument;
  const std::string suffix = ":lamp";
  if (file.size() > suffix.size() && file.compare(file.size() - suffix.size(), suffix.size(), suffix) == 0) {
    file.resize(file.size() - suffix.size());
    out.features = GnnFeatures::kLamp;
  }
  out.name = std::filesystem::path(file).stem().string() +
             (out.features == GnnFeatures::kLamp ? " (lamp features)" : "");
  if (network_kind(file) == "loopwise") {
    if (out.features == GnnFeatures::kLamp)
      throw InputError(file + ": :lamp is for networks of the paper's kind");
    out.loopwise = std::make_shared<const EffectNetwork>(file);
  } else {
    out.paper = std::make_shared<const GraphNetwork>(file);
  }
  return out;
}

std::vector<Judgement> judge(const MissionRecord& record, const std::vector<Judged>& networks,
                             const JudgeOptions& options, const StopToken& stop) {
  validate(options);
  std::vector<Judgement> out;
  for (std::size_t s = 0; s < stages().size(); ++s) {
    Trial trial(record, s, networks, options);
    for (const double wanted : options.set_sizes) {
      const auto B = static_cast<std::size_t>(wanted);
      if (2 * B > trial.stage.candidates.size()) continue;
      if (stop.stop_requested()) throw Error("interrupted");
      Judgement base;
      base.mission = record.name;
      base.group = record.group;
      base.other_size = record.other_size;
      base.stage = s;
      base.nodes = trial.stage.graph.nodes().size();
      base.set_size = B;
      judge_size(trial, base, Rng(combine_seeds(combine_seeds(options.seed, s), B)), out);
    }
  }
  return out;
}

JudgementTables summarize(const std::vector<Judgement>& judgements) {
  std::vector<std::string> methods;
  std::set<std::size_t> sizes;
  for (const Judgement& j : judgements) {
    if (std::find(methods.begin(), methods.end(), j.method) == methods.end()) methods.push_back(j.method);
    sizes.insert(j.set_size);
  }
  struct Column {
    const char* name;
    const char* title;
    double Judgement::*value;
    int decimals;
  };
  const Column columns[] = {{"log_error", "error of log e", &Judgement::log_error, 3},
                            {"spearman_mixed", "(a) mixed sizes", &Judgement::spearman_mixed, 2},
                            {"spearman_fixed", "(b) one size", &Judgement::spearman_fixed, 2},
                            {"signs", "(c) right signs", &Judgement::signs, 2},
                            {"chosen", "e of the chosen", &Judgement::chosen, 4}};
  JudgementTables out;
  Json rows = Json::array();
  for (const bool other : {false, true}) {
    std::set<std::string> missions, graphs;
    std::size_t least = std::numeric_limits<std::size_t>::max(), most = 0;
    for (const Judgement& j : judgements) {
      if (j.other_size != other) continue;
      missions.insert(j.mission);
      graphs.insert(j.mission + " " + std::to_string(j.stage));
      least = std::min(least, j.nodes);
      most = std::max(most, j.nodes);
    }
    if (missions.empty()) continue;
    out.markdown += std::string(other ? "Sizes never trained on" : "Sizes as trained on") + ": " +
                    std::to_string(missions.size()) + " missions, " + std::to_string(graphs.size()) +
                    " graphs of " + std::to_string(least) + " to " + std::to_string(most) +
                    " nodes. Medians over graphs.\n\n| B | method |";
    for (const Column& column : columns) out.markdown += std::string(" ") + column.title + " |";
    out.markdown += "\n| --- | --- | --- | --- | --- | --- | --- |\n";
    for (const std::size_t B : sizes) {
      for (const std::string& method : methods) {
        Json row = {{"other_size", other}, {"set_size", B}, {"method", method}};
        std::string line = "| " + std::to_string(B) + " | " + method + " |";
        std::size_t count = 0;
        for (const Column& column : columns) {
          std::vector<double> values;
          for (const Judgement& j : judgements) {
            if (j.other_size == other && j.set_size == B && j.method == method)
              values.push_back(j.*column.value);
          }
          count = values.size();
          const Quartiles q = quartiles(values);
          char text[32] = "-";
          if (q.count > 0) {
            std::snprintf(text, sizeof text, "%.*f", column.decimals, q.median);
            row[column.name] = {{"lower", q.lower}, {"median", q.median}, {"upper", q.upper}};
          }
          line += std::string(" ") + text + " |";
        }
        if (count == 0) continue;
        row["graphs"] = count;
        rows.push_back(row);
        out.markdown += line + "\n";
      }
    }
    out.markdown += "\n";
  }
  out.json = json_text(rows, 2);
  return out;
}

}  // namespace loopwise::training
