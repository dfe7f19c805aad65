// SPDX-License-Identifier: BSD-3-Clause
// Formats of a RegistrationResult in files and messages: lines of JSON, and bytes.
#include <loopwise/replay/result_codec.hpp>

#include <limits>

#include <Eigen/Cholesky>

#include <loopwise/replay/replay.hpp>

#include "byte_stream.hpp"
#include "outcome_json.hpp"

namespace loopwise {
namespace {

/// Optional parts in the bytes of a result.
enum Parts : std::uint8_t { kPose = 1, kClosure = 2, kIncomplete = 4, kTaskHash = 8, kAllParts = 15 };

/// Figures of a result, in the order of its bytes.
constexpr double RegistrationResult::*kFigures[] = {
    &RegistrationResult::sac_fitness_m2, &RegistrationResult::gicp_fitness_m2, &RegistrationResult::overlap,
    &RegistrationResult::features_s,     &RegistrationResult::global_s,        &RegistrationResult::refine_s};

void require_closure_unless_rejected(const RegistrationResult& result) {
  if ((result.reason == RejectionReason::kNone) != result.closure.has_value()) {
    throw InputError("an outcome is verified without a closure, or rejected with one");
  }
}

Eigen::Isometry3d pose_of(const Json& list, bool any_numbers) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.affine() = matrix_of<Eigen::Matrix<double, 3, 4>>(list);
  if (!any_numbers && !(se3::rotation_defect(T.linear()) <= 1e-6)) {
    throw InputError("a pose is not a rigid transform");
  }
  return T;
}

}  // namespace

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

Json outcome_json(const RegistrationResult& result) {
  Json line = Json::object();
  put_result(line, result);
  line["seconds"] = {result.features_s, result.global_s, result.refine_s};
  if (result.incomplete) line["incomplete"] = true;
  if (result.task_hash != 0) line["task"] = std::to_string(result.task_hash);
  return line;
}

RegistrationResult outcome_from(const Json& json, bool any_numbers) {
  RegistrationResult result;
  result.candidate.from = parse_key(json.at("from").get<std::string>());
  result.candidate.to = parse_key(json.at("to").get<std::string>());
  result.candidate.source = parse_enum<CandidateSource>("source", json.at("source").get<std::string>());
  result.reason = parse_enum<RejectionReason>("reason", json.at("reason").get<std::string>());
  if (json.contains("message")) result.message = json["message"].get<std::string>();
  if (json.contains("T_from_to")) result.T_from_to = pose_of(json["T_from_to"], any_numbers);
  if (json.contains("closure")) {
    LoopClosure closure;
    closure.from = result.candidate.from;
    closure.to = result.candidate.to;
    closure.T_from_to = pose_of(json["closure"].at("T_from_to"), any_numbers);
    closure.covariance = matrix_of<Matrix6d>(json["closure"].at("covariance"));
    if (!any_numbers && (!closure.covariance.allFinite() ||
                         Eigen::LLT<Matrix6d>(closure.covariance).info() != Eigen::Success)) {
      throw InputError("covariance is not positive definite");
    }
    result.closure = closure;
  }
  result.sac_fitness_m2 = number_or_nan(json.at("sac_fitness_m2"));
  result.gicp_fitness_m2 = number_or_nan(json.at("gicp_fitness_m2"));
  result.overlap = number_or_nan(json.at("overlap"));
  const Json& seconds = json.at("seconds");
  double* const parts[] = {&result.features_s, &result.global_s, &result.refine_s};
  for (std::size_t i = 0; i < 3; ++i) {
    *parts[i] = number_or_nan(seconds.at(i));
    if (!any_numbers && !(*parts[i] >= 0.0)) throw InputError("a time is not a number >= 0");
  }
  if (json.contains("incomplete")) result.incomplete = json["incomplete"].get<bool>();
  if (json.contains("task")) result.task_hash = parse_key(json["task"].get<std::string>());
  require_closure_unless_rejected(result);
  return result;
}

std::string outcome_line(const RegistrationResult& result) {
  return json_text(outcome_json(result));
}

RegistrationResult parse_outcome_line(const std::string& line) {
  try {
    return outcome_from(Json::parse(line));
  } catch (const Json::exception& error) {
    throw InputError(std::string("not an outcome: ") + error.what());
  } catch (const Error& error) {
    throw InputError(std::string("not an outcome: ") + error.what());
  }
}

std::string pack_result(const RegistrationResult& result) {
  ByteWriter out;
  out.put(static_cast<std::uint8_t>(result.reason));
  out.put(static_cast<std::uint8_t>((result.T_from_to ? kPose : 0) | (result.closure ? kClosure : 0) |
                                    (result.incomplete ? kIncomplete : 0) |
                                    (result.task_hash != 0 ? kTaskHash : 0)));
  for (const auto figure : kFigures) out.put(result.*figure);
  if (result.T_from_to) out.put(*result.T_from_to);
  if (result.closure) out.put(result.closure->T_from_to).matrix(result.closure->covariance);
  out.put(result.message);
  if (result.task_hash != 0) out.put(result.task_hash);
  return out.take();
}

RegistrationResult unpack_result(std::string_view bytes, const LoopCandidate& candidate) {
  ByteReader in(bytes);
  RegistrationResult result;
  result.candidate = candidate;
  result.reason =
      static_cast<RejectionReason>(in.one_of(static_cast<std::uint8_t>(RejectionReason::kTimeLimit)));
  const std::uint8_t parts = in.one_of(kAllParts);
  for (const auto figure : kFigures) result.*figure = in.get<double>();
  if ((parts & kPose) != 0) result.T_from_to = in.pose();
  if ((parts & kClosure) != 0) {
    LoopClosure closure;
    closure.from = candidate.from;
    closure.to = candidate.to;
    closure.T_from_to = in.pose();
    closure.covariance = in.matrix<Matrix6d>();
    result.closure = closure;
  }
  result.incomplete = (parts & kIncomplete) != 0;
  result.message = in.text();
  if ((parts & kTaskHash) != 0) result.task_hash = in.get<std::uint64_t>();
  in.end();
  require_closure_unless_rejected(result);
  return result;
}

}  // namespace loopwise
