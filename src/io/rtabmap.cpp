// SPDX-License-Identifier: BSD-3-Clause
// The tables are those of RTAB-Map 0.18 and later; its versions change no column that is read here.
#include "rtabmap.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

#include "bag_storage.hpp"
#include "cloud_points.hpp"
#include "inflate.hpp"
#include "information.hpp"
#include "sqlite_file.hpp"

namespace loopwise::parts {
namespace {

namespace fs = std::filesystem;
using sqlite::Statement;

/// Types of a link, as the program numbers them.
enum LinkType { kNeighbor = 0, kUserClosure = 4, kVirtualClosure = 5, kNeighborMerged = 6 };

/// Reads the rows of a 3x4 matrix of floats. Empty if the blob is empty or the null matrix, which stands for
/// no pose.
std::optional<Eigen::Isometry3d> pose_in_blob(std::string_view blob) {
  std::array<float, 12> v{};
  if (blob.size() != sizeof v) return std::nullopt;
  std::memcpy(v.data(), blob.data(), sizeof v);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (Eigen::Index row = 0; row < 3; ++row) {
    for (Eigen::Index column = 0; column < 4; ++column)
      T(row, column) = static_cast<double>(v[static_cast<std::size_t>(4 * row + column)]);
  }
  constexpr double kSlack = 1e-3;  // floats, composed many times
  const Eigen::Matrix3d R = T.linear();
  const bool is_pose = T.matrix().allFinite() && R.determinant() > 0.0 &&
                       (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < kSlack;
  if (!is_pose) return std::nullopt;
  return se3::normalized(T);
}

/// A matrix as the program compresses it: zlib's data, then its rows, its columns and OpenCV's type.
struct Matrix {
  std::string bytes;
  std::size_t channels = 0;
  bool is_float = false;
  std::size_t count = 0;  // of elements, each of so many channels
};
Matrix unpacked_matrix(std::string_view blob) {
  std::array<std::int32_t, 3> tail{};
  if (blob.size() < sizeof tail) throw InputError("compressed data are cut short");
  std::memcpy(tail.data(), blob.data() + blob.size() - sizeof tail, sizeof tail);
  const auto [rows, columns, type] = tail;
  constexpr int kInt32 = 4, kFloat32 = 5, kMostChannels = 512;
  if (rows < 0 || columns < 0 || type < 0 || type / 8 >= kMostChannels ||
      (type % 8 != kFloat32 && type % 8 != kInt32)) {
    throw InputError("a matrix of " + std::to_string(rows) + " x " + std::to_string(columns) + " of type " +
                     std::to_string(type) + ", expected 32-bit numbers");
  }
  Matrix out;
  out.channels = static_cast<std::size_t>(type / 8 + 1);
  out.is_float = type % 8 == kFloat32;
  out.count = static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
  if (out.count > bags::kLargestPiece / 4 / out.channels)
    throw InputError("a matrix of " + std::to_string(out.count) + " elements is too large");
  const std::size_t size = out.count * out.channels * 4;
  out.bytes = inflate_zlib(blob.substr(0, blob.size() - sizeof tail), size);
  if (out.bytes.size() != size) {
    throw InputError("a matrix of " + std::to_string(size) + " bytes unpacks to " +
                     std::to_string(out.bytes.size()));
  }
  return out;
}

/// Description of the points of a stored scan.
struct ScanInfo {
  int format = 0;  // LaserScan::Format; 0 if the version did not store it
  Eigen::Isometry3d T_body_lidar = Eigen::Isometry3d::Identity();
};
ScanInfo scan_info_of(std::string_view blob) {
  constexpr std::size_t kPose = 12;
  std::vector<float> v(blob.size() / sizeof(float));
  if (blob.size() % sizeof(float) != 0 || v.size() < kPose) throw InputError("its scan_info is cut short");
  std::memcpy(v.data(), blob.data(), blob.size());
  const std::size_t before = v.size() - kPose;  // 7 since 0.18, 3 since 0.16.1, 2 before
  if (before != 7 && before != 3 && before != 2)
    throw InputError("its scan_info of " + std::to_string(v.size()) + " numbers is of an unknown version");
  ScanInfo info;
  const float format = before == 7 ? v[0] : before == 3 ? v[2] : 0.0F;
  if (!(format >= 0.0F && format < 100.0F)) throw InputError("its scan is of an unknown format");
  info.format = static_cast<int>(format);
  const auto T = pose_in_blob(blob.substr(before * sizeof(float)));
  if (!T) throw InputError("the pose of its lidar on the robot is invalid");
  info.T_body_lidar = *T;
  return info;
}

/// LaserScan::Format 1 to 4 are of 2D scanners; 5 and above begin with x, y, z.
bool is_flat(int format) {
  return format >= 1 && format <= 4;
}
/// The channel of the intensity: XYZI, XYZI with normals, XYZIT, XYZIRT.
bool has_intensity(int format) {
  return format == 6 || format == 9 || format == 11 || format == 12;
}

/// Scans by node. Thread-safe.
class Scans {
 public:
  Scans(const fs::path& file, std::string name)
      : name_(std::move(name)),
        database_(file, name_, {}),
        row_(database_.handle(), "SELECT scan, scan_info FROM Data WHERE id = ?1") {}

  CloudFile load(Key key) {
    const std::string place = name_ + ": scan of node " + std::to_string(key);
    try {
      const auto [scan, info] = row_of(key);
      return cloud_of(unpacked_matrix(scan), scan_info_of(info), place);
    } catch (const InputError& error) {
      throw InputError(place + ": " + error.what());
    }
  }

 private:
  std::pair<std::string, std::string> row_of(Key key) {
    const std::lock_guard<std::mutex> lock(mutex_);
    row_.bind(static_cast<std::int64_t>(key));
    if (!row_.next()) throw InputError("is missing");
    std::pair<std::string, std::string> row{row_.bytes(0), row_.bytes(1)};
    row_.reset();
    return row;
  }

  static CloudFile cloud_of(const Matrix& matrix, const ScanInfo& info, const std::string& place) {
    if (!matrix.is_float || matrix.channels < 3)
      throw InputError("has " + std::to_string(matrix.channels) + " numbers a point, expected x, y and z");
    const bool intensity = has_intensity(info.format) && matrix.channels > 3;
    points::CloudBuilder builder(place, false, intensity);
    builder.reserve(matrix.count);
    std::array<float, 4> v{};
    for (std::size_t i = 0; i < matrix.count; ++i) {
      std::memcpy(v.data(), matrix.bytes.data() + i * matrix.channels * 4, intensity ? 16 : 12);
      const Eigen::Vector3d p = info.T_body_lidar * Eigen::Vector3f(v[0], v[1], v[2]).cast<double>();
      std::array<double, points::kChannels> channels{};
      for (std::size_t axis = 0; axis < 3; ++axis) channels[axis] = p[static_cast<Eigen::Index>(axis)];
      channels[points::kIntensity] = static_cast<double>(v[3]);
      builder.add(channels.data());
    }
    return builder.finish();
  }

  std::string name_;
  std::mutex mutex_;
  sqlite::Database database_;
  Statement row_;
};

struct StoredNode {
  Key key;
  std::int64_t map;
  Eigen::Isometry3d odometry;
};

/// Reads all tables except the scans.
class DatabaseReader {
 public:
  DatabaseReader(const fs::path& file, const MissionOptions& options, const Work& work)
      : name_(file.string()), database_(file, name_, work.stop), options_(options) {
    if (work.progress) work.progress({"checking " + name_, 0, 0, ""});
    database_.checked([&] {
      database_.check_pages();
      for (const char* const table : {"Node", "Data", "Link", "Admin"}) {
        if (!database_.has_table(table))
          throw InputError(std::string("has no table ") + table + ": not a database of RTAB-Map");
      }
      read_links();
      read_nodes();
      read_optimized();
      read_scans();
    });
  }

  Mission mission(const fs::path& path, const fs::path& file) {
    Mission mission;
    mission.kind = MissionKind::kRtabmap;
    mission.path = path;
    mission.name = name_of(path);
    const Robots robots = maps_as_robots(mission.name);
    const PoseGraph graph = graph_of(robots);
    mission.robots = robots_of(graph, options_, robots);
    complete_stamps(graph, mission.robots, options_, name_, stamps_, problems_);
    std::vector<PriorFactor> priors;
    complete_priors(graph, mission.robots, options_, name_, priors, problems_);
    mission.problems = std::move(problems_);
    mission.graph =
        assemble(graph, stamps_, priors, mission.robots, options_, mission.problems, without_information_);
    check_stamps(mission);
    set_reference(mission, std::move(optimized_));
    if (!truth_.empty()) {
      set_ground_truth(mission, std::move(truth_));
      align_truth_to_nodes(mission, name_);
    }
    if (scans_.empty()) {
      mission.problems.add_altered("no lidar scan in the database",
                                   name_ + ": its depth images are not read, record it with a 3D lidar");
    } else {
      const auto scans = std::make_shared<Scans>(file, name_);
      set_scans(
          mission, scans_, [scans](Key key) { return scans->load(key); },
          [&](Key key) { return name_ + ": node " + std::to_string(key); }, options_);
    }
    mission.provenance_json = provenance_of(mission.kind, {file.filename().string()});
    return mission;
  }

 private:
  [[nodiscard]] std::string place(std::int64_t from, std::int64_t to) const {
    return name_ + ": " + std::to_string(from) + " to " + std::to_string(to);
  }

  /// Both nodes of a link store it; the later one stores the inverse.
  void read_links() {
    std::set<std::pair<std::int64_t, std::int64_t>> seen;
    Statement rows(database_.handle(),
                   "SELECT from_id, to_id, type, transform, information_matrix FROM Link ORDER BY rowid");
    while (rows.next()) {
      const std::int64_t from = rows.integer(0, "from_id of a link"), to = rows.integer(1, "to_id of a link"),
                         type = rows.integer(2, "the type of a link");
      if (from == to || from <= 0 || to <= 0) {
        problems_.add_altered(from == to ? "prior or gravity of a node left out" : "landmark left out",
                              place(from, to));
        continue;
      }
      if (type < 0 || type == kVirtualClosure || type > kNeighborMerged) {
        problems_.add_altered("link of an unsupported type left out", place(from, to));
        continue;
      }
      if (seen.count(std::minmax(from, to)) != 0) continue;
      const auto T = pose_in_blob(rows.bytes(3));
      if (!T) {
        problems_.add_altered("link without a pose left out", place(from, to));
        continue;
      }
      seen.insert(std::minmax(from, to));
      if (type == kNeighbor || type == kNeighborMerged) neighbours_.insert(std::minmax(from, to));
      links_.push_back(
          {static_cast<Key>(from), static_cast<Key>(to), *T, information_of(rows.bytes(4), from, to)});
    }
  }

  /// The information of a link, or zero if it is unusable; graph_of() replaces zero.
  Matrix6d information_of(std::string_view blob, std::int64_t from, std::int64_t to) {
    Matrix6d information = Matrix6d::Zero();
    if (blob.size() != sizeof(double) * 36) return information;
    std::memcpy(information.data(), blob.data(),
                blob.size());  // symmetric, so the order of storage does not matter
    information = (0.5 * information + 0.5 * information.transpose()).eval();  // no overflow
    if (!information.allFinite()) return Matrix6d::Zero();
    const SoundInformation sound = nearest_information(information);
    if (sound.flaw == InformationFlaw::kIndefinite)
      problems_.add_altered("information not positive semi-definite, its negative eigenvalues set to 0",
                            place(from, to));
    return sound.matrix;
  }

  void read_nodes() {
    std::set<Key> linked;
    for (const Edge& link : links_) linked.insert({link.from, link.to});
    Statement rows(database_.handle(),
                   "SELECT id, map_id, weight, stamp, pose, ground_truth_pose FROM Node ORDER BY id");
    constexpr std::int64_t kInvalid = -9;  // weight of nodes that the program gave up
    while (rows.next()) {
      const std::int64_t id = rows.integer(0, "the id of a node");
      const auto pose = pose_in_blob(rows.bytes(4));
      const std::string where = name_ + ": node " + std::to_string(id);
      if (id <= 0 || !pose || rows.number(2) <= static_cast<double>(kInvalid)) {
        problems_.add_altered("node without odometry left out", where);
        continue;
      }
      const auto key = static_cast<Key>(id);
      if (linked.count(key) == 0) {
        problems_.add_altered("node without a link left out", where);
        continue;
      }
      if (!nodes_.empty() && nodes_.back().key == key)
        throw InputError("node " + std::to_string(id) + " appears twice");
      nodes_.push_back({key, rows.integer(1, "map_id of a node"), *pose});
      const double stamp_ns = rows.number(3) * 1e9;
      if (stamp_ns > 0.0 && stamp_ns < 4.6e18) stamps_.emplace(key, std::llround(stamp_ns));
      if (const auto truth = pose_in_blob(rows.bytes(5))) truth_.emplace(key, *truth);
    }
    if (nodes_.empty()) throw InputError("has no node with odometry and a link");
  }

  /// Reads the optimised poses of the map that the program had when it ended.
  void read_optimized() {
    Statement rows(database_.handle(), "SELECT opt_ids, opt_poses FROM Admin");
    if (!rows.next() || rows.bytes(0).empty() || rows.bytes(1).empty()) return;
    const Matrix ids = unpacked_matrix(rows.bytes(0)), poses = unpacked_matrix(rows.bytes(1));
    constexpr std::size_t kPose = 12;
    if (ids.is_float || !poses.is_float || ids.channels != 1 || poses.channels != 1 ||
        poses.count != kPose * ids.count)
      throw InputError("the numbers of optimised poses and of their ids differ");
    for (std::size_t i = 0; i < ids.count; ++i) {
      std::int32_t id = 0;
      std::memcpy(&id, ids.bytes.data() + 4 * i, sizeof id);
      const auto pose = pose_in_blob(
          std::string_view(poses.bytes).substr(i * kPose * sizeof(float), kPose * sizeof(float)));
      if (pose && id > 0) optimized_.emplace(static_cast<Key>(id), *pose);
    }
  }

  void read_scans() {
    Statement rows(database_.handle(), "SELECT id, scan_info FROM Data WHERE length(scan) > 4 ORDER BY id");
    while (rows.next()) {
      const std::int64_t id = rows.integer(0, "the id of a scan");
      if (id <= 0 || !std::binary_search(nodes_.begin(), nodes_.end(), static_cast<Key>(id), Less{}))
        continue;
      if (rows.bytes(1).empty()) {
        problems_.add_altered("scan without scan_info left out", name_ + ": node " + std::to_string(id));
        continue;
      }
      try {
        if (is_flat(scan_info_of(rows.bytes(1)).format)) {
          problems_.add_altered("scan of a 2D scanner left out", name_ + ": node " + std::to_string(id));
          continue;
        }
      } catch (const InputError& error) {
        throw InputError("node " + std::to_string(id) + ": " + error.what());
      }
      scans_.push_back(static_cast<Key>(id));
    }
  }

  /// Each run of nodes of one map is a robot, because odometry restarts with each run.
  [[nodiscard]] Robots maps_as_robots(const std::string& name) const {
    std::vector<Robot> robots;
    std::map<std::int64_t, std::size_t> runs;  // by map
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const StoredNode& node = nodes_[i];
      if (i == 0 || node.map != nodes_[i - 1].map) {
        const std::size_t before = runs[node.map]++;
        robots.push_back(
            {name + "_" + std::to_string(node.map) + (before > 0 ? "_" + std::to_string(before) : ""),
             node.key, node.key, false});
      }
      robots.back().last = node.key;
    }
    if (robots.size() == 1) robots.front().name = name;
    return Robots(std::move(robots));
  }

  /// Poses follow odometry from the first node of each robot. That node has the program's optimised pose, if
  /// there is one.
  PoseGraph graph_of(const Robots& robots) {
    std::map<std::pair<Key, Key>, Eigen::Isometry3d> steps;
    for (const Edge& link : links_) {
      // A closure between consecutive nodes is not their odometry step.
      if (neighbours_.count(
              std::minmax(static_cast<std::int64_t>(link.from), static_cast<std::int64_t>(link.to))) == 0)
        continue;
      steps.emplace(std::pair(link.from, link.to), link.T_from_to);
      steps.emplace(std::pair(link.to, link.from), link.T_from_to.inverse());
    }
    PoseGraph graph;
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const StoredNode& stored = nodes_[i];
      const bool begins = i == 0 || robots.of(stored.key) != robots.of(nodes_[i - 1].key);
      if (begins) {
        const std::optional<Eigen::Isometry3d> placed = placed_start(robots, i);
        pose = placed.value_or(stored.odometry);
        if (!placed && robots.size() > 1)
          problems_.add(kWithoutFrame, name_ + ": map " + std::to_string(stored.map) + ", see --frames auto");
      } else {
        const auto step = steps.find({nodes_[i - 1].key, stored.key});
        const Eigen::Isometry3d T =
            step != steps.end() ? step->second : nodes_[i - 1].odometry.inverse() * stored.odometry;
        if (step == steps.end()) {
          problems_.add_altered(
              "odometry without a link taken from the nodes",
              place(static_cast<std::int64_t>(nodes_[i - 1].key), static_cast<std::int64_t>(stored.key)));
          links_.push_back({nodes_[i - 1].key, stored.key, se3::normalized(T), Matrix6d::Zero()});
        }
        pose = se3::normalized(pose * T);
      }
      Node node;
      node.key = stored.key;
      node.pose = pose;
      graph.add_node(node);
    }
    add_links(graph);
    return graph;
  }

  /// Optimised pose of the first node of a robot, chained from its first node that the last map has.
  [[nodiscard]] std::optional<Eigen::Isometry3d> placed_start(const Robots& robots, std::size_t first) const {
    const std::size_t robot = robots.of(nodes_[first].key);
    for (std::size_t i = first; i < nodes_.size() && robots.of(nodes_[i].key) == robot; ++i) {
      const auto known = optimized_.find(nodes_[i].key);
      if (known == optimized_.end()) continue;
      if (i == first) return known->second;
      return se3::normalized(known->second * nodes_[i].odometry.inverse() * nodes_[first].odometry);
    }
    return std::nullopt;
  }

  void add_links(PoseGraph& graph) {
    for (Edge& link : links_) {
      if (!graph.contains(link.from) || !graph.contains(link.to)) {
        problems_.add_altered("link to a node that is left out",
                              name_ + ": " + std::to_string(link.from) + " to " + std::to_string(link.to));
        continue;
      }
      // The identity stands for a covariance that is not stated.
      const bool stated =
          !link.information.isZero() && !link.information.isApprox(Matrix6d::Identity(), 1e-9);
      if (!stated) {
        link.information = Matrix6d::Identity();
        without_information_.push_back(graph.edges().size());
        problems_.add_altered("link without a covariance, given that of the options",
                              name_ + ": " + std::to_string(link.from) + " to " + std::to_string(link.to));
      }
      graph.add_edge(link);
    }
  }

  struct Less {
    bool operator()(const StoredNode& node, Key key) const { return node.key < key; }
    bool operator()(Key key, const StoredNode& node) const { return key < node.key; }
  };

  std::string name_;
  sqlite::Database database_;
  const MissionOptions& options_;
  Problems problems_;
  std::vector<Edge> links_;
  std::set<std::pair<std::int64_t, std::int64_t>>
      neighbours_;                 // pairs, the lower id first, whose link is odometry
  std::vector<StoredNode> nodes_;  // ascending
  Stamps stamps_;
  std::map<Key, Eigen::Isometry3d> truth_, optimized_;
  std::vector<Key> scans_;
  std::vector<std::size_t> without_information_;
};

}  // namespace

bool is_rtabmap_database(const fs::path& file) {
  try {
    sqlite::Database database(file, file.string(), {});
    return database.has_table("Node") && database.has_table("Link") && database.has_table("Admin");
  } catch (const InputError&) {
    return false;  // cut short or damaged, which the reader of its kind reports
  }
}

Mission read_rtabmap(const fs::path& path, const MissionOptions& options, const Work& work) {
  fs::path file = path;
  if (fs::is_directory(path)) {
    const std::vector<fs::path> databases = rtabmap_databases(path);
    if (databases.size() > 1) {
      throw InputError(path.string() + ": has " + std::to_string(databases.size()) +
                       " databases of RTAB-Map, give one of them: " + databases.front().string() + " ...");
    }
    if (databases.empty()) throw InputError(path.string() + ": has no database of RTAB-Map");
    file = databases.front();
  }
  return DatabaseReader(file, options, work).mission(path, file);
}

}  // namespace loopwise::parts
