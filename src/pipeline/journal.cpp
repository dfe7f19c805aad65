// SPDX-License-Identifier: BSD-3-Clause
#include "journal.hpp"

#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/pipeline/replay.hpp>

namespace loopwise {
namespace {

Json account_json(const CandidateAccounting& a) {
  return {{"generated", a.generated}, {"pruned", a.pruned},   {"expired", a.expired},
          {"waiting", a.waiting},     {"pending", a.pending}, {"in_flight", a.in_flight},
          {"computed", a.computed}};
}

Json new_line(const char* name, double time_s) {
  return {{"event", name}, {"time_s", time_s}};
}

std::string finish(Json line, const CandidateAccounting& a) {
  line["account"] = account_json(a);
  return json_text(line);
}

/// Row by row.
template <class Matrix>
Json numbers(const Matrix& matrix) {
  Json list = Json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) list.push_back(matrix(r, c));
  }
  return list;
}

template <class Matrix>
Matrix matrix_of(const Json& list) {
  Matrix matrix;
  if (list.size() != static_cast<std::size_t>(matrix.size()))
    throw InputError("not an outcome: a matrix has another size");
  std::size_t i = 0;
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) matrix(r, c) = list[i++].get<double>();
  }
  return matrix;
}

double number_or_nan(const Json& value) {
  return value.is_null() ? std::numeric_limits<double>::quiet_NaN() : value.get<double>();
}

void put_result(Json& line, const RegistrationResult& result) {
  line["from"] = std::to_string(result.candidate.from);
  line["to"] = std::to_string(result.candidate.to);
  line["source"] = enum_name(result.candidate.source);
  line["outcome"] = result.verified() ? "verified" : "rejected";
  line["reason"] = enum_name(result.reason);
  if (!result.message.empty()) line["message"] = result.message;
  if (result.T_from_to) line["T_from_to"] = numbers(result.T_from_to->matrix().topRows<3>());
  if (result.closure) {
    line["closure"] = {{"T_from_to", numbers(result.closure->T_from_to.matrix().topRows<3>())},
                       {"covariance", numbers(result.closure->covariance)}};
  }
  line["sac_fitness_m2"] = result.sac_fitness_m2;  // NaN becomes null
  line["gicp_fitness_m2"] = result.gicp_fitness_m2;
  line["overlap"] = result.overlap;
}

Eigen::Isometry3d pose_of(const Json& list) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.affine() = matrix_of<Eigen::Matrix<double, 3, 4>>(list);
  if (se3::rotation_defect(T.linear()) > 1e-6) {
    throw InputError("not an outcome: a pose is not a rigid transform");
  }
  return T;
}

}  // namespace

namespace journal {

std::string start_line(const Mission& mission, const Config& config) {
  Json line = new_line("start", 0.0);
  line["format"] = 1;
  line["mission"] = mission.name;
  line["key_frames"] = mission.graph.nodes().size();
  line["options"] = parse_json(config_json(config), "options");
  return finish(std::move(line), {});
}

std::string key_frame_line(double time_s, Key key, std::size_t candidates, const CandidateAccounting& a) {
  Json line = new_line("key_frame", time_s);
  line["key"] = std::to_string(key);
  line["candidates"] = candidates;
  return finish(std::move(line), a);
}

std::string batch_line(double time_s, const std::vector<LoopCandidate>& batch, const CandidateAccounting& a) {
  Json line = new_line("batch", time_s);
  Json pairs = Json::array();
  for (const LoopCandidate& candidate : batch) {
    pairs.push_back({std::to_string(candidate.from), std::to_string(candidate.to)});
  }
  line["pairs"] = std::move(pairs);
  return finish(std::move(line), a);
}

std::string result_line(double time_s, const RegistrationResult& result, const CandidateAccounting& a) {
  Json line = new_line("result", time_s);
  put_result(line, result);
  return finish(std::move(line), a);
}

std::string live_result_line(double time_s, const RegistrationResult& result,
                             const ModuleStatistics& statistics) {
  Json line = new_line("result", time_s);
  put_result(line, result);
  line["queues"] = {{"events", statistics.events_waiting},
                    {"producer_waits", statistics.producer_waits},
                    {"overdue", statistics.overdue_now}};
  return finish(std::move(line), statistics.candidates);
}

std::string estimate_line(double time_s, const GncResult& gnc, const CandidateAccounting& a) {
  Json line = new_line("estimate", time_s);
  line["cost"] = gnc.optimization.cost;
  line["inliers"] = gnc.inliers;
  line["outliers"] = gnc.outliers;
  line["outer_iterations"] = gnc.outer_iterations;
  line["converged"] = gnc.optimization.converged;
  return finish(std::move(line), a);
}

std::string end_line(double time_s, bool interrupted, const CandidateAccounting& a) {
  Json line = new_line("end", time_s);
  line["interrupted"] = interrupted;
  return finish(std::move(line), a);
}

}  // namespace journal

std::string outcome_line(const RegistrationResult& result) {
  Json line = Json::object();
  put_result(line, result);
  line["seconds"] = {result.features_s, result.global_s, result.refine_s};
  if (result.incomplete) line["incomplete"] = true;
  if (result.task_hash != 0) line["task"] = std::to_string(result.task_hash);
  return json_text(line);
}

RegistrationResult parse_outcome_line(const std::string& line) {
  try {
    const Json json = Json::parse(line);
    RegistrationResult result;
    result.candidate.from = parse_key(json.at("from").get<std::string>());
    result.candidate.to = parse_key(json.at("to").get<std::string>());
    result.candidate.source = parse_enum<CandidateSource>("source", json.at("source").get<std::string>());
    result.reason = parse_enum<RejectionReason>("reason", json.at("reason").get<std::string>());
    if (json.contains("message")) result.message = json["message"].get<std::string>();
    if (json.contains("T_from_to")) result.T_from_to = pose_of(json["T_from_to"]);
    if (json.contains("closure")) {
      LoopClosure closure;
      closure.from = result.candidate.from;
      closure.to = result.candidate.to;
      closure.T_from_to = pose_of(json["closure"].at("T_from_to"));
      closure.covariance = matrix_of<Matrix6d>(json["closure"].at("covariance"));
      if (!closure.covariance.allFinite() ||
          Eigen::LLT<Matrix6d>(closure.covariance).info() != Eigen::Success) {
        throw InputError("not an outcome: covariance is not positive definite");
      }
      result.closure = closure;
    }
    result.sac_fitness_m2 = number_or_nan(json.at("sac_fitness_m2"));
    result.gicp_fitness_m2 = number_or_nan(json.at("gicp_fitness_m2"));
    result.overlap = number_or_nan(json.at("overlap"));
    const Json& seconds = json.at("seconds");
    result.features_s = seconds.at(0).get<double>();
    result.global_s = seconds.at(1).get<double>();
    result.refine_s = seconds.at(2).get<double>();
    if (json.contains("incomplete")) result.incomplete = json["incomplete"].get<bool>();
    if (json.contains("task")) result.task_hash = parse_key(json["task"].get<std::string>());
    if ((result.reason == RejectionReason::kNone) != result.closure.has_value()) {
      throw InputError("an outcome is verified without a closure, or rejected with one");
    }
    return result;
  } catch (const Json::exception& error) {
    throw InputError(std::string("not an outcome: ") + error.what());
  } catch (const OptionError& error) {
    throw InputError(std::string("not an outcome: ") + error.what());
  }
}

}  // namespace loopwise
