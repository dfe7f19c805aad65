// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The test of a cloud's bytes, for all formats.
#pragma once

#include "checks.hpp"
#include "cloud_points.hpp"

namespace loopwise::fuzz {

inline void check_same(const PointCloud& a, const PointCloud& b) {
  expect(a.points == b.points, "written and read again: the points are the same");
  expect(a.normals.size() == b.normals.size() || a.empty(), "written and read again: as many normals");
  expect(a.intensities == b.intensities || a.empty(), "written and read again: the intensities are the same");
}

inline void read_and_write_cloud(const std::string& name, std::string_view bytes) {
  const auto file = attempt([&] { return points::parse_cloud(name, std::string(bytes)); });
  if (!file) return;
  check_cloud(file->cloud);
  check_problems(file->problems);
  const std::size_t choice = bytes.size() % 4;
  if (choice == 3) {
    write_ply(scratch() / "again.ply", file->cloud);
    check_same(file->cloud, read_cloud(scratch() / "again.ply").cloud);
  } else {
    write_pcd(scratch() / "again.pcd", file->cloud, static_cast<PcdEncoding>(choice));
    check_same(file->cloud, read_cloud(scratch() / "again.pcd").cloud);
  }
}

}  // namespace loopwise::fuzz
