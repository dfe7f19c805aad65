// SPDX-License-Identifier: BSD-3-Clause
// Small folders of sweeps, and as other SLAM programs save them.
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/cloud.hpp>

#include "mission_seeds.hpp"

namespace loopwise::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMatrix = "1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1\n";
constexpr const char* kMoved = "1 0 0 4\n0 1 0 3\n0 0 1 4\n0 0 0 1\n";

PointCloud few_points() {
  PointCloud cloud;
  cloud.points = {Eigen::Vector3f(1.0f, 2.0f, 0.5f), Eigen::Vector3f(-1.0f, 2.0f, 0.5f)};
  return cloud;
}

void write_submap(const fs::path& folder, const std::string& pose, const std::string& stamp) {
  fs::create_directories(folder);
  const std::string matrix = kMatrix;
  write_file(folder / "data.txt",
             "id: 0\nT_world_origin: \n" + pose + "T_origin_endpoint_L: \n" + matrix +
                 "T_origin_endpoint_R: \n" + matrix + "T_lidar_imu: \n" + matrix +
                 "imu_bias: 0 0 0 0 0 0\nframe_id: 1\nnum_frames: 1\nframe_0\nid: 0\nstamp: " + stamp +
                 "\nT_odom_lidar: \n" + pose + "T_world_lidar: \n" + pose + "v_world_imu: 0 0 0\n");
  write_file(folder / "points_compact.bin", std::string("\0\0\x80\x3f\0\0\0\x40\0\0\0\0", 12));
}

void write_key_frame(const fs::path& folder, const std::string& number, const std::string& robot,
                     const std::string& id) {
  write_file(folder / (number + ".txt"),
             "robot_name " + robot + "\nstamp 1600000000 5\nestimate\n" + kMatrix + "g2o_id " + id + "\n");
  write_pcd(folder / (number + ".pcd"), few_points());
}

std::string open3d_text() {
  const std::string pose = "[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 2, 3, 4, 1]";
  std::string information = "[";
  for (int i = 0; i < 36; ++i) information += std::string(i > 0 ? ", " : "") + (i % 7 == 0 ? "9" : "0");
  return R"({"class_name": "PoseGraph", "edges": [{"class_name": "PoseGraphEdge", "confidence": 1.0, )"
         R"("information": )" +
         information + R"(], "source_node_id": 0, "target_node_id": 1, "transformation": )" + pose +
         R"(, "uncertain": false}], "nodes": [{"pose": )" + pose + R"(}, {"pose": )" + pose + "}]}\n";
}

}  // namespace

void write_seed_saved_maps(const fs::path& folder) {
  const std::string tum = "1600000000.5 0 0 0 0 0 0 1\n1600000001.5 2 0 0 0 0 0 1\n",
                    kitti = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2\n",
                    graph =
                        "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 2 0 0 0 0 0 1\n"
                        "EDGE_SE3:QUAT 1 0 -2 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";
  const PointCloud cloud = few_points();
  for (const char* made : {"kitti/velodyne", "stamped", "glim", "fast_lio/scans", "hba/pcd", "voxel",
                           "kiss/plys", "mrg/g2o", "mrg/keyframes", "open3d"})
    fs::create_directories(folder / made);
  write_file(folder / "kitti" / "poses.txt", kitti);
  write_file(folder / "kitti" / "times.txt", "0\n1.03e-01\n");
  write_file(folder / "kitti" / "calib.txt", "P0: 1 2\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n");
  for (const char* number : {"000000.bin", "000001.bin"})
    write_file(folder / "kitti" / "velodyne" / number, std::string(32, '\0'));
  write_file(folder / "stamped" / "poses.txt", tum);
  write_pcd(folder / "stamped" / "1600000000.500000000.pcd", cloud);
  write_pcd(folder / "stamped" / "1600000001.500000000.pcd", cloud);
  write_file(folder / "glim" / "graph.txt", "num_submaps: 2\nnum_matching_cost_factors: 1\n");
  write_submap(folder / "glim" / "000000", kMatrix, "1600000000.5");
  write_submap(folder / "glim" / "000001", kMoved, "1600000001.5");
  write_file(folder / "fast_lio" / "poses_tum.txt", tum);
  write_pcd(folder / "fast_lio" / "scans" / "000000.pcd", cloud);
  write_file(folder / "hba" / "pose.json", "0 0 0 1 0 0 0\n2 0 0 1 0 0 0");
  write_pcd(folder / "hba" / "pcd" / "0.pcd", cloud);
  write_file(folder / "voxel" / "alidarState.txt", tum);
  write_pcd(folder / "voxel" / "0.pcd", cloud);
  write_file(folder / "kiss" / "local_map_graph.g2o", graph);
  write_ply(folder / "kiss" / "plys" / "000000.ply", cloud);
  write_file(folder / "mrg" / "g2o" / "graph.g2o", graph);
  write_key_frame(folder / "mrg" / "keyframes", "000000", "husky", "0");
  write_key_frame(folder / "mrg" / "keyframes", "000001", "spot", "1");
  write_file(folder / "open3d" / "graph.json", open3d_text());
  write_ply(folder / "open3d" / "fragment_000.ply", cloud);
}

}  // namespace loopwise::fuzz
