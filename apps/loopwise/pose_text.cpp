// SPDX-License-Identifier: BSD-3-Clause
#include "pose_text.hpp"

#include <loopwise/evaluation/text_tables.hpp>

namespace loopwise::cli {

std::string matrix_rows(const Eigen::Isometry3d& T, int decimals) {
  const auto width = static_cast<std::size_t>(decimals) + 7;
  std::string rows;
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      const std::string value = fixed(T(r, c), decimals);
      rows += std::string(value.size() < width ? width - value.size() : 1, ' ') + value;
    }
    rows += "\n";
  }
  return rows;
}

std::string point_text(const Eigen::Vector3d& p) {
  return fixed(p.x(), 0) + " " + fixed(p.y(), 0) + " " + fixed(p.z(), 0);
}

std::string pose_text(const Eigen::Isometry3d& T_files, const Eigen::Isometry3d& T_origins,
                      const CloudOrigins& origins) {
  if (origins.zero()) return "T_target_source\n" + matrix_rows(T_files, 6);
  // The 12th digit of a rotation moves points at a distance of 5000 km by 5 micrometres.
  std::string text = "T_target_source, in the coordinates of the files\n" + matrix_rows(T_files, 12);
  text += "origin       " + point_text(origins.target) + " m";
  if (origins.target != origins.source)
    text += " in the target, " + point_text(origins.source) + " m in the source";
  return text + ": the following values refer to it\nT_target_source, about the origin\n" +
         matrix_rows(T_origins, 6);
}

}  // namespace loopwise::cli
