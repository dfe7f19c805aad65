// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What all tests share: Catch2 of either major version, temporary folders, the real data where it is
/// present.
#pragma once

#ifdef LOOPWISE_CATCH2_V3
#include <catch2/catch_all.hpp>
using Catch::Approx;
using Catch::Matchers::Contains;
#else
#include <catch2/catch.hpp>
using Catch::Matchers::Contains;
#endif

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <optional>
#include <sstream>
#include <string>

#include <Eigen/Geometry>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise::testing {

namespace fs = std::filesystem;

/// A folder of its own that goes with the object.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (fs::temp_directory_path() / "loopwise-test-XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("cannot make a temporary folder");
    path_ = pattern;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] const fs::path& path() const { return path_; }
  [[nodiscard]] fs::path operator/(const std::string& name) const { return path_ / name; }

 private:
  fs::path path_;
};

inline void write_text(const fs::path& path, const std::string& text) {
  std::ofstream out(path, std::ios::binary);
  out << text;
}

[[nodiscard]] inline std::string read_text(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream out;
  out << in.rdbuf();
  return out.str();
}

/// Path of a part of the real data ("g2o", "kaist03", ...). If it is missing, prints a message and returns
/// nothing; the test then returns at once.
[[nodiscard]] inline std::optional<fs::path> test_data(const std::string& part) {
  const char* variable = std::getenv("LOOPWISE_TEST_DATA");
  const fs::path path = fs::path(variable ? variable : LOOPWISE_TEST_DATA_DEFAULT) / part;
  if (fs::exists(path)) return path;
  std::cerr << "SKIPPED: no test data at " << path.string() << "\n";
  SUCCEED("no test data");
  return std::nullopt;
}

/// Uniform direction, angle uniform in [0, max_angle], translation normal with `sigma_m`.
[[nodiscard]] inline Eigen::Isometry3d random_pose(Rng& rng, double sigma_m = 1.0, double max_angle = 3.0) {
  Eigen::Vector3d axis(rng.normal(), rng.normal(), rng.normal());
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = se3::so3_exp(axis.normalized() * rng.uniform(0.0, max_angle));
  T.translation() = sigma_m * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
  return T;
}

/// Largest absolute difference of the two matrices' elements.
[[nodiscard]] inline double difference(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return (a.matrix() - b.matrix()).cwiseAbs().maxCoeff();
}

}  // namespace loopwise::testing
