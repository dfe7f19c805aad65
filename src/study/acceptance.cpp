// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/study/acceptance.hpp>

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>

#include "tables.hpp"

namespace loopwise::study {
namespace {

/// One of the two models, in the report.
struct Model {
  AcceptanceOutcome outcome;
  const char* title;
  const char* option;
};
constexpr Model kModels[] = {{AcceptanceOutcome::kVerified, "A candidate is verified", "verified_weights"},
                             {AcceptanceOutcome::kRight, "A verified closure is kept", "right_weights"}};

std::string scores_text(const AcceptanceFit& fit) {
  std::vector<std::vector<std::string>> rows{
      {"mission left out", "samples", "positive", "ROC area", "by distance alone", "Brier score"}};
  for (const AcceptanceScore& score : fit.scores) {
    rows.push_back({score.mission, std::to_string(score.count), std::to_string(score.positive),
                    fixed(score.auc, 3), fixed(score.auc_by_distance, 3), fixed(score.brier, 3)});
  }
  if (fit.scores.empty()) return "One mission: nothing to leave out.\n";
  const bool some_unscored =
      std::any_of(fit.scores.begin(), fit.scores.end(),
                  [](const AcceptanceScore& score) { return score.count > 0 && std::isnan(score.brier); });
  return markdown_table(rows) +
         (some_unscored
              ? "\nA mission without a score: the others have no sample of each outcome to fit to.\n"
              : "");
}

std::string reliability_text(const Calibration& calibration) {
  std::vector<std::vector<std::string>> rows{{"chance", "samples", "mean chance", "came true"}};
  for (std::size_t b = 0; b < calibration.bins().size(); ++b) {
    const Calibration::Bin& bin = calibration.bins()[b];
    if (bin.count == 0) continue;
    const auto count = static_cast<double>(bin.count);
    rows.push_back(
        {fixed(0.1 * static_cast<double>(b), 1) + " to " + fixed(0.1 * static_cast<double>(b + 1), 1),
         std::to_string(bin.count), fixed(bin.expected / count, 3),
         fixed(static_cast<double>(bin.verified) / count, 3)});
  }
  return rows.size() > 1 ? "\n" + markdown_table(rows) : std::string();
}

std::string weights_text(const AcceptanceModel::Terms& weights) {
  std::string text;
  for (const double weight : weights) text += (text.empty() ? "" : ",") + fixed(weight, 2);
  return text;
}

Json scores_json(const AcceptanceFit& fit) {
  Json rows = Json::array();
  for (const AcceptanceScore& score : fit.scores) {
    rows.push_back({{"mission", score.mission},
                    {"samples", score.count},
                    {"positive", score.positive},
                    {"auc", number_or_null(score.auc)},
                    {"auc_by_distance", number_or_null(score.auc_by_distance)},
                    {"brier", number_or_null(score.brier)}});
  }
  return rows;
}

}  // namespace

AcceptanceReport fit_chances(const std::vector<AcceptanceSamples>& missions) {
  AcceptanceReport report;
  Json json = {{"terms", AcceptanceModel::term_names()}}, weights = Json::object();
  std::string failure;
  report.markdown = "# Chances of candidates\n";
  for (const Model& model : kModels) {
    report.markdown += std::string("\n## ") + model.title + "\n\n";
    try {
      const AcceptanceFit fit = fit_acceptance(missions, model.outcome);
      weights[model.option] = weights_text(fit.weights);
      json[model.option] = {{"weights", fit.weights}, {"left_out", scores_json(fit)}};
      report.markdown += scores_text(fit) + reliability_text(fit.calibration) +
                         "\nFitted to all: `--set expected." + model.option + "=" +
                         weights_text(fit.weights) + "`\n";
    } catch (const InputError& error) {
      failure = error.what();
      json[model.option] = {{"weights", nullptr}, {"reason", failure}};
      report.markdown += "Not fitted: " + failure + "\n";
      report.problems.push_back(std::string(model.option) + " not fitted: " + failure);
    }
  }
  if (weights.empty()) throw InputError(failure);
  report.weights = json_text({{"expected", weights}}, 2) + "\n";
  report.json = json_text(json, 2) + "\n";
  return report;
}

}  // namespace loopwise::study
