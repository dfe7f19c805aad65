// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/candidates.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>

#include "testing.hpp"

namespace loopwise::candidates_test {

TEST_CASE("candidates: pairs alone, with scores, with poses, in any order of columns", "[io][candidates]") {
  const auto pairs = parse_candidates("from,to\na12,b3\n7,9\n", "pairs.csv");
  REQUIRE(pairs.size() == 2);
  REQUIRE(pairs[0].from == make_key('a', 12));
  REQUIRE(pairs[0].to == make_key('b', 3));
  REQUIRE(pairs[0].source == CandidateSource::kUser);
  REQUIRE(pairs[0].recognition == nullptr);

  const auto all = parse_candidates(
      "score, to, from, x,y,z,qx,qy,qz,qw\r\n"
      "0.25,b3,a12,1,2,3,0,0,0.6,0.8\n"
      ",b4,a12,,,,,,,\n"
      "\n"
      "0.5,b5,a12,,,,,,,\n",
      "pairs.csv");
  REQUIRE(all.size() == 3);
  REQUIRE(all[0].recognition->similarity == 0.25);
  REQUIRE(all[0].recognition->T_from_to->translation() == Eigen::Vector3d(1.0, 2.0, 3.0));
  REQUIRE(se3::rotation_angle(*all[0].recognition->T_from_to) == Approx(2.0 * std::asin(0.6)));
  REQUIRE(all[1].recognition == nullptr);
  REQUIRE(all[2].recognition->similarity == 0.5);
  REQUIRE_FALSE(all[2].recognition->T_from_to);
}

TEST_CASE("candidates: errors name file, line and column", "[io][candidates][error]") {
  const auto message = [](const char* text) -> std::string {
    try {
      static_cast<void>(parse_candidates(text, "pairs.csv"));
    } catch (const ParseError& error) {
      return error.what();
    }
    return "no error";
  };
  CHECK_THAT(message("a,b\n1,2\n"), Contains("pairs.csv:1") && Contains("from,to"));
  CHECK_THAT(message(""), Contains("pairs.csv:1"));
  CHECK_THAT(message("from,to,x,y\n1,2,3,4\n"), Contains("x,y,z,qx,qy,qz,qw"));
  CHECK_THAT(message("from,to,score\n1,2,1.5\n"), Contains("pairs.csv:2") && Contains("[0, 1]"));
  CHECK_THAT(message("from,to,score\n1,2,nan\n"), Contains("pairs.csv:2"));
  CHECK_THAT(message("from,to\n1,2\n3,3\n"), Contains("pairs.csv:3") && Contains("itself"));
  const std::string pose = "from,to,x,y,z,qx,qy,qz,qw\n";
  CHECK_THAT(message((pose + "1,2,0,0,0,0,0,0,\n").c_str()), Contains("all of x,y,z,qx,qy,qz,qw"));
  CHECK_THAT(message((pose + "1,2,0,0,0,1,1,0,0\n").c_str()), Contains("unit length"));
  REQUIRE_THROWS_AS(read_candidates("/no/such/file.csv"), IoError);
}

TEST_CASE("candidates: exchanging the ends inverts the pose and transforms its covariance",
          "[io][candidates]") {
  auto candidate =
      parse_candidates("from,to,x,y,z,qx,qy,qz,qw\n1,2,1,2,3,0,0,0.6,0.8\n", "pairs.csv").front();
  const Eigen::Isometry3d T = *candidate.recognition->T_from_to;
  const Matrix6d covariance = candidate.recognition->covariance;
  swap_ends(candidate);
  REQUIRE(candidate.from == 2);
  REQUIRE(testing::difference(*candidate.recognition->T_from_to, T.inverse()) < 1e-12);
  // A perturbation of T on the right is one of its inverse, seen through Ad(T).
  REQUIRE((candidate.recognition->covariance - se3::covariance_of_inverse(T, covariance)).norm() < 1e-12);
  swap_ends(candidate);
  REQUIRE((candidate.recognition->covariance - covariance).norm() < 1e-9);
}

}  // namespace loopwise::candidates_test
