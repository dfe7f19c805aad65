// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Folders of sweeps as data sets have them, names and number formats included.
#pragma once

#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include <loopwise/io/cloud.hpp>

#include "cloud_testing.hpp"
#include "saver_data.hpp"
#include "testing.hpp"

namespace loopwise::testing {

/// Poses of a lidar on a car: along its x axis at 8 m/s, in a curve, ten sweeps a second.
inline std::vector<Eigen::Isometry3d> car_drive(std::size_t count) {
  Vector6d step;
  step << 0.8, 0.0, 0.0, 0.0, 0.0, 0.02;
  std::vector<Eigen::Isometry3d> poses;
  for (std::size_t i = 0; i < count; ++i) poses.push_back(se3::exp(static_cast<double>(i) * step));
  return poses;
}

/// Pose of the lidar in the frame of the camera, whose z axis looks forward and whose y axis down.
inline Eigen::Isometry3d T_camera_lidar() {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  T.linear() = se3::so3_exp(Eigen::Vector3d(0.01, -0.02, 0.015)) * T.linear();
  T.translation() << 0.05, -0.08, -0.27;
  return T;
}

/// As KITTI's tools print matrices: 6 decimals with exponent.
inline std::string scientific_rows(const std::vector<Eigen::Isometry3d>& poses, const std::string& tag = "") {
  std::string out;
  for (const Eigen::Isometry3d& T : poses) {
    out += tag;
    for (int i = 0; i < 12; ++i) {
      char number[40];
      std::snprintf(number, sizeof number, "%.12e", T(i / 4, i % 4));
      out += std::string(i > 0 || !tag.empty() ? " " : "") + number;
    }
    out += "\n";
  }
  return out;
}

/// The contents of KITTI velodyne files: x, y, z and reflectance as floats. The first point identifies the
/// sweep.
inline void write_kitti_bin(const fs::path& file, std::size_t sweep, std::size_t points = 30) {
  std::ofstream out(file, std::ios::binary);
  Rng rng(static_cast<unsigned>(sweep) + 1);
  for (std::size_t i = 0; i < points; ++i) {
    const float values[] = {i == 0 ? static_cast<float>(sweep) : static_cast<float>(rng.uniform(-40.0, 40.0)),
                            static_cast<float>(rng.uniform(-40.0, 40.0)),
                            static_cast<float>(rng.uniform(-2.0, 3.0)),
                            static_cast<float>(rng.uniform(0.0, 1.0))};
    out.write(reinterpret_cast<const char*>(values), sizeof values);
  }
}

/// A sequence of KITTI's odometry data. Its poses are those of the camera.
inline void write_kitti_sequence(const fs::path& folder, std::size_t sweeps) {
  fs::create_directories(folder / "velodyne");
  std::vector<Eigen::Isometry3d> camera;
  const Eigen::Isometry3d Tr = T_camera_lidar();
  for (const Eigen::Isometry3d& lidar : car_drive(sweeps)) camera.push_back(Tr * lidar * Tr.inverse());
  std::string times;
  for (std::size_t i = 0; i < sweeps; ++i) {
    char number[40];
    std::snprintf(number, sizeof number, "%.6e\n", 0.103 * static_cast<double>(i));
    times += number;
    write_kitti_bin(folder / "velodyne" / (six_digits(i) + ".bin"), i);
  }
  const std::string row = " 7.18856e+02 0 6.071928e+02 0 0 7.18856e+02 1.852157e+02 0 0 0 1 0\n";
  write_text(folder / "calib.txt",
             "P0:" + row + "P1:" + row + "P2:" + row + "P3:" + row + scientific_rows({Tr}, "Tr:"));
  write_text(folder / "times.txt", times);
  write_text(folder / "poses.txt", scientific_rows(camera));
}

/// Poses in TUM's form; stamps in seconds of nine decimals.
inline std::string tum_rows(const std::vector<Eigen::Isometry3d>& poses,
                            const std::vector<std::int64_t>& stamps_ns) {
  std::string out = "# timestamp tx ty tz qx qy qz qw\n";
  for (std::size_t i = 0; i < poses.size(); ++i) {
    char stamp[40];
    std::snprintf(stamp, sizeof stamp, "%lld.%09lld", static_cast<long long>(stamps_ns[i] / 1'000'000'000),
                  static_cast<long long>(stamps_ns[i] % 1'000'000'000));
    out += stamp + decimals(poses[i]) + "\n";
  }
  return out;
}

}  // namespace loopwise::testing
