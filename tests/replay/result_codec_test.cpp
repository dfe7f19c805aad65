// SPDX-License-Identifier: BSD-3-Clause
// Results of registrations as bytes and as lines of JSON.
#include <loopwise/replay/result_codec.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/replay/replay.hpp>

#include "testing.hpp"

namespace loopwise::result_codec_test {
namespace {

RegistrationResult random_result(Rng& rng) {
  RegistrationResult result;
  result.candidate.id = rng.below(1000000);
  result.candidate.from = rng();
  result.candidate.to = rng();
  result.candidate.source = rng.uniform() < 0.5 ? CandidateSource::kRadio : CandidateSource::kProximity;
  const auto names = enum_names(RejectionReason{});
  result.reason = rng.uniform() < 0.4 ? RejectionReason::kNone : names[rng.below(names.size())].first;
  const auto some_number = [&] { return rng.uniform() < 0.3 ? std::nan("") : rng.normal(0.0, 3.0); };
  if (result.reason != RejectionReason::kNone) result.message = "why: \"ä\" \n" + std::to_string(rng());
  if (rng.uniform() < 0.7) result.T_from_to = testing::random_pose(rng, 10.0);
  if (result.reason == RejectionReason::kNone) {
    Matrix6d root;
    for (Eigen::Index i = 0; i < root.size(); ++i) root(i) = rng.normal(0.0, 0.1);
    LoopClosure closure;
    closure.from = result.candidate.from;
    closure.to = result.candidate.to;
    closure.T_from_to = testing::random_pose(rng, 10.0);
    closure.covariance = root * root.transpose() + 1e-6 * Matrix6d::Identity();
    result.closure = closure;
  }
  result.sac_fitness_m2 = some_number();
  result.gicp_fitness_m2 = some_number();
  result.overlap = some_number();
  result.features_s = rng.uniform();
  result.global_s = rng.uniform();
  result.refine_s = rng.uniform();
  result.incomplete = rng.uniform() < 0.3;
  result.task_hash = rng.uniform() < 0.5 ? rng() : 0;
  return result;
}

bool same_number(double a, double b) {
  return a == b || (std::isnan(a) && std::isnan(b));
}

/// Compares every field. A new field does not compile until it is added here, and the codec has to keep it.
void require_same(const RegistrationResult& a, const RegistrationResult& b) {
  const auto& [candidate, reason, message, closure, T, sac, gicp, overlap, features, global, refine,
               incomplete, task] = a;
  REQUIRE(candidate.from == b.candidate.from);
  REQUIRE(candidate.to == b.candidate.to);
  REQUIRE(candidate.source == b.candidate.source);
  REQUIRE(reason == b.reason);
  REQUIRE(message == b.message);
  REQUIRE(closure.has_value() == b.closure.has_value());
  if (closure) {
    const auto& [from, to, T_from_to, covariance] = *closure;
    REQUIRE(from == b.closure->from);
    REQUIRE(to == b.closure->to);
    REQUIRE(T_from_to.matrix() == b.closure->T_from_to.matrix());
    REQUIRE(covariance == b.closure->covariance);
  }
  REQUIRE(T.has_value() == b.T_from_to.has_value());
  if (T) REQUIRE(T->matrix() == b.T_from_to->matrix());
  REQUIRE(same_number(sac, b.sac_fitness_m2));
  REQUIRE(same_number(gicp, b.gicp_fitness_m2));
  REQUIRE(same_number(overlap, b.overlap));
  REQUIRE(features == b.features_s);
  REQUIRE(global == b.global_s);
  REQUIRE(refine == b.refine_s);
  REQUIRE(incomplete == b.incomplete);
  REQUIRE(task == b.task_hash);
}

}  // namespace

TEST_CASE("result codec: bytes and lines keep every field to the bit", "[replay][outcomes][property]") {
  Rng rng(3);
  for (int trial = 0; trial < 300; ++trial) {
    CAPTURE(trial);
    const RegistrationResult result = random_result(rng);
    const std::string bytes = pack_result(result);
    const RegistrationResult unpacked = unpack_result(bytes, result.candidate);
    require_same(result, unpacked);
    REQUIRE(unpacked.candidate.id == result.candidate.id);  // the asker's own
    REQUIRE(pack_result(unpacked) == bytes);
    REQUIRE_THROWS_AS(unpack_result(bytes.substr(0, rng.below(bytes.size())), result.candidate), InputError);
    REQUIRE_THROWS_AS(unpack_result(bytes + "x", result.candidate), InputError);
    require_same(result, parse_outcome_line(outcome_line(result)));
  }
}

TEST_CASE("result codec: bytes are those of records that outcome stores hold", "[replay][outcomes]") {
  RegistrationResult result;
  result.reason = RejectionReason::kLowOverlap;
  result.message = "ab";
  result.sac_fitness_m2 = result.gicp_fitness_m2 = result.overlap = 0.0;
  const std::string bytes = pack_result(result);
  REQUIRE(bytes.size() == 2 + 6 * 8 + 4 + 2);
  REQUIRE(static_cast<int>(bytes[0]) == static_cast<int>(RejectionReason::kLowOverlap));
  REQUIRE(static_cast<int>(bytes[1]) == 0);
  REQUIRE(bytes.substr(bytes.size() - 2) == "ab");
  result.T_from_to = Eigen::Isometry3d::Identity();
  REQUIRE(pack_result(result).size() == bytes.size() + 12 * 8);
  REQUIRE(static_cast<int>(pack_result(result)[1]) == 1);
  result.reason = RejectionReason::kNone;
  result.closure = LoopClosure{};
  REQUIRE(pack_result(result).size() == bytes.size() + (12 + 12 + 36) * 8);
  REQUIRE(static_cast<int>(pack_result(result)[1]) == 3);
}

TEST_CASE("result codec: bytes that contradict themselves are refused", "[replay][outcomes][error]") {
  RegistrationResult result;
  result.reason = RejectionReason::kFailed;
  std::string bytes = pack_result(result);
  bytes[1] = 16;  // parts that there are not
  REQUIRE_THROWS_AS(unpack_result(bytes, {}), InputError);
  bytes = pack_result(result);
  bytes[0] = 0;  // verified, without a closure
  REQUIRE_THROWS_AS(unpack_result(bytes, {}), InputError);
}

}  // namespace loopwise::result_codec_test
