// SPDX-License-Identifier: BSD-3-Clause
#include "optimization_graphs.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <map>

#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/optimization/optimizer.hpp>

namespace loopwise::bench {
namespace {

constexpr double kSigmaM = 0.02;
constexpr double kSigmaRad = 0.005;
constexpr double kTorusSigmaM = 0.1;
constexpr double kTorusSigmaRad = 0.05;

PriorFactor firm_prior(Key key, const Eigen::Isometry3d& pose) {
  PriorFactor prior;
  prior.key = key;
  prior.pose = pose;
  prior.information = 1e8 * Matrix6d::Identity();
  return prior;
}

Matrix6d information(double sigma_m, double sigma_rad) {
  Vector6d d;
  d << Eigen::Vector3d::Constant(1.0 / (sigma_m * sigma_m)),
      Eigen::Vector3d::Constant(1.0 / (sigma_rad * sigma_rad));
  return d.asDiagonal();
}

Edge measured(Rng& rng, Key from, Key to, const Eigen::Isometry3d& T, EdgeKind kind, double sigma_m = kSigmaM,
              double sigma_rad = kSigmaRad) {
  Vector6d noise;
  for (int i = 0; i < 6; ++i) noise[i] = (i < 3 ? sigma_m : sigma_rad) * rng.normal();
  Edge edge;
  edge.from = from;
  edge.to = to;
  edge.T_from_to = se3::normalized(T * se3::exp(noise));
  edge.information = information(sigma_m, sigma_rad);
  edge.kind = kind;
  return edge;
}

/// A measurement with noise as the information says.
Edge measured_with(Rng& rng, Key from, Key to, const Eigen::Isometry3d& T, EdgeKind kind,
                   const Matrix6d& information, double scale = 1.0) {
  Vector6d white;
  for (int i = 0; i < 6; ++i) white[i] = scale * rng.normal();
  Edge edge;
  edge.from = from;
  edge.to = to;
  // With Ω = LLᵀ, noise of covariance Ω⁻¹ is L⁻ᵀ times white noise.
  edge.T_from_to = se3::normalized(T * se3::exp(information.llt().matrixU().solve(white)));
  edge.information = 0.5 * (information + information.transpose());
  edge.kind = kind;
  return edge;
}

Eigen::Isometry3d pose_at(const Eigen::Vector3d& place, double yaw) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.translation() = place;
  T.linear() = se3::so3_exp(Eigen::Vector3d(0.0, 0.0, yaw));
  return T;
}

/// Nodes chained along noisy odometry; every robot starts at its true pose and has a prior there.
BenchGraph walk(Rng& rng, const std::vector<std::vector<Eigen::Isometry3d>>& paths, double sigma_m = kSigmaM,
                double sigma_rad = kSigmaRad) {
  BenchGraph out;
  std::vector<Edge> edges;
  Key key = 0;
  for (const auto& path : paths) {
    Eigen::Isometry3d estimate = path.front();
    for (std::size_t i = 0; i < path.size(); ++i, ++key) {
      if (i > 0) {
        edges.push_back(measured(rng, key - 1, key, path[i - 1].inverse() * path[i], EdgeKind::kOdometry,
                                 sigma_m, sigma_rad));
        estimate = se3::normalized(estimate * edges.back().T_from_to);
      }
      Node node;
      node.key = key;
      node.pose = estimate;
      out.graph.add_node(node);
      if (i == 0) out.graph.add_prior(firm_prior(key, estimate));
    }
  }
  for (const Edge& edge : edges) out.graph.add_edge(edge);
  out.is_false.assign(edges.size(), false);
  return out;
}

/// True paths of robots in the streets of a square grid.
struct Walks {
  std::vector<std::vector<Eigen::Isometry3d>> paths;   ///< By robot
  std::vector<Eigen::Isometry3d> truth;                ///< Of all robots, by key
  std::map<std::pair<int, int>, std::vector<Key>> at;  ///< Visits of a place
};

/// \param crossings of one street; 0: by the number of poses
Walks walk_streets(Rng& rng, std::size_t poses, std::size_t robots, double step_m, int crossings) {
  constexpr int kBlock = 10;  // steps between crossings
  if (crossings == 0)
    crossings = std::max(3, static_cast<int>(std::sqrt(static_cast<double>(poses) / (4.0 * kBlock))));
  Walks out;
  for (std::size_t robot = 0; robot < robots; ++robot) {
    const std::size_t count = poses / robots;
    int x = kBlock * static_cast<int>(rng.below(static_cast<std::uint64_t>(crossings)));
    int y = kBlock * static_cast<int>(rng.below(static_cast<std::uint64_t>(crossings)));
    int heading = static_cast<int>(rng.below(4));
    std::vector<Eigen::Isometry3d> path;
    const int dx[] = {1, 0, -1, 0}, dy[] = {0, 1, 0, -1};
    while (path.size() < count) {
      if (x % kBlock == 0 && y % kBlock == 0) {
        const int last = kBlock * (crossings - 1);
        do {
          const auto turn = static_cast<int>(rng.below(4));
          heading = (heading + (turn == 3 ? 3 : turn == 2 ? 1 : 0)) % 4;
        } while (x + dx[heading] < 0 || x + dx[heading] > last || y + dy[heading] < 0 ||
                 y + dy[heading] > last);
      }
      x += dx[heading];
      y += dy[heading];
      out.at[{x, y}].push_back(out.truth.size());
      path.push_back(pose_at({step_m * x, step_m * y, 0.0}, 0.5 * 3.14159265358979323846 * heading));
      out.truth.push_back(path.back());
    }
    out.paths.push_back(std::move(path));
  }
  return out;
}

/// Calls `add` with random pairs of visits of places that are at most a step apart along each axis.
template <class Add>
void each_revisit(Rng& rng, const Walks& walks, double step_m, std::size_t count, Add&& add) {
  for (std::size_t added = 0, tries = 0; added < count && tries < 50 * count; ++tries) {
    const Key a = rng.below(walks.truth.size());
    const auto x = static_cast<int>(std::lround(walks.truth[a].translation().x() / step_m));
    const auto y = static_cast<int>(std::lround(walks.truth[a].translation().y() / step_m));
    const int beside_x = x + static_cast<int>(rng.below(3)) - 1;
    const int beside_y = y + static_cast<int>(rng.below(3)) - 1;
    const auto found = walks.at.find({beside_x, beside_y});
    if (found == walks.at.end()) continue;
    const Key b = found->second[rng.below(found->second.size())];
    if (a == b || a + 1 == b || b + 1 == a) continue;
    add(a, b);
    ++added;
  }
}

/// Layers of square grids, walked row by row and back, with closures between neighbours.
BenchGraph boustrophedon(int side, int layers, std::uint64_t seed) {
  Rng rng(seed);
  std::vector<Eigen::Isometry3d> path;
  std::map<std::array<int, 3>, Key> at;
  for (int z = 0; z < layers; ++z) {
    for (int row = 0; row < side; ++row) {
      for (int column = 0; column < side; ++column) {
        const int y = z % 2 == 0 ? row : side - 1 - row;
        const int x = (row + z * side) % 2 == 0 ? column : side - 1 - column;
        at[{x, y, z}] = path.size();
        path.push_back(pose_at(Eigen::Vector3d(x, y, z), 0.5 * static_cast<double>(rng.below(12))));
      }
    }
  }
  BenchGraph out = walk(rng, {path});
  for (const auto& [cell, a] : at) {
    for (int axis = 0; axis < 3; ++axis) {
      auto next = cell;
      ++next[static_cast<std::size_t>(axis)];
      const auto found = at.find(next);
      if (found == at.end() || found->second == a + 1 || a == found->second + 1) continue;
      const Key b = found->second;
      out.graph.add_edge(measured(rng, a, b, path[a].inverse() * path[b], EdgeKind::kLoopClosure));
      out.is_false.push_back(false);
    }
  }
  return out;
}

/// Ratio of the deviations of right closures at the minimum to the stated ones, which are often pessimistic
/// in published graphs; at most 1.
double noise_of_closures(const BenchGraph& graph) {
  PoseGraph clean = graph.graph;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) clean.set_weight(e, graph.is_false[e] ? 0.0 : 1.0);
  const std::vector<Eigen::Isometry3d> poses = optimize(clean).poses;
  double sum = 0.0;
  std::size_t count = 0;
  for (std::size_t e = 0; e < graph.is_false.size(); ++e) {
    const Edge& edge = clean.edges()[e];
    if (graph.is_false[e] || edge.kind != EdgeKind::kLoopClosure) continue;
    const Vector6d r = edge_residual(edge, poses[clean.ends(e).from], poses[clean.ends(e).to]);
    sum += r.dot(edge.information * r);
    ++count;
  }
  const double ratio = count == 0 ? 1.0 : std::sqrt(sum / (6.0 * static_cast<double>(count)));
  return ratio > 0.5 ? 1.0 : ratio;
}

}  // namespace

BenchGraph read_bench_graph(const std::filesystem::path& path) {
  BenchGraph out;
  out.name = path.stem().string();
  out.graph = read_g2o(path).graph;
  for (std::size_t k = 0; k < out.graph.edges().size(); ++k) {
    const Edge& edge = out.graph.edges()[k];
    out.graph.set_kind(k, edge.to == edge.from + 1 ? EdgeKind::kOdometry : EdgeKind::kLoopClosure);
  }
  std::vector<Key> anchors{out.graph.nodes().front().key};
  if (out.name.rfind("tunnel1250", 0) == 0) anchors.push_back(625);
  for (const Key key : anchors) out.graph.add_prior(firm_prior(key, out.graph.node(key).pose));
  out.is_false.assign(out.graph.edges().size(), false);
  std::filesystem::path labels = path;
  std::ifstream label_file(labels.replace_extension(".labels"));
  int label = 0;
  for (std::size_t e = 0; e < out.is_false.size() && label_file >> label; ++e) out.is_false[e] = label != 0;
  return out;
}

std::vector<std::filesystem::path> g2o_files(const std::string& folder) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() == ".g2o" && name.find("truth") == std::string::npos)
      files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

BenchGraph streets(std::size_t poses, std::size_t closures, std::size_t robots, std::uint64_t seed) {
  Rng rng(seed);
  constexpr double kStep = 2.0;
  const Walks walks = walk_streets(rng, poses, robots, kStep, 0);
  BenchGraph out = walk(rng, walks.paths);
  out.name =
      "streets " + std::to_string(poses) + "/" + std::to_string(closures) + "/" + std::to_string(robots);
  each_revisit(rng, walks, kStep, closures, [&](Key a, Key b) {
    out.graph.add_edge(
        measured(rng, a, b, walks.truth[a].inverse() * walks.truth[b], EdgeKind::kLoopClosure));
    out.is_false.push_back(false);
  });
  return out;
}

BenchGraph rooms(std::size_t poses, std::size_t closures, std::uint64_t seed) {
  Rng rng(seed);
  constexpr double kStep = 1.0;
  constexpr int kCrossings = 4;
  const Walks walks = walk_streets(rng, poses, 1, kStep, kCrossings);
  BenchGraph out = walk(rng, walks.paths, kTorusSigmaM, kTorusSigmaRad);
  out.name = "rooms " + std::to_string(poses) + "/" + std::to_string(closures);
  each_revisit(rng, walks, kStep, closures, [&](Key a, Key b) {
    // Deviations from a third to three times those of odometry, along axes of its own.
    Eigen::Isometry3d own = Eigen::Isometry3d::Identity();
    own.linear() = se3::so3_exp(Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()));
    own.translation() = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal());
    const Matrix6d ad = se3::adjoint(own);
    Vector6d scale;
    for (int i = 0; i < 6; ++i) scale[i] = std::pow(10.0, rng.uniform(-1.0, 1.0));
    const Matrix6d stated = information(kTorusSigmaM, kTorusSigmaRad) * scale.asDiagonal();
    out.graph.add_edge(measured_with(rng, a, b, walks.truth[a].inverse() * walks.truth[b],
                                     EdgeKind::kLoopClosure, ad.transpose() * stated * ad));
    out.is_false.push_back(false);
  });
  return out;
}

BenchGraph lattice(std::size_t poses, std::uint64_t seed) {
  const auto side = static_cast<int>(std::lround(std::cbrt(static_cast<double>(poses))));
  BenchGraph out = boustrophedon(side, side, seed);
  out.name = "lattice " + std::to_string(out.graph.nodes().size());
  return out;
}

BenchGraph grid(std::size_t poses, std::uint64_t seed) {
  BenchGraph out =
      boustrophedon(static_cast<int>(std::lround(std::sqrt(static_cast<double>(poses)))), 1, seed);
  out.name = "grid " + std::to_string(out.graph.nodes().size());
  return out;
}

BenchGraph torus(std::size_t poses, std::uint64_t seed) {
  constexpr std::size_t kAround = 100;
  constexpr double kPi = 3.14159265358979323846;
  Rng rng(seed);
  std::vector<Eigen::Isometry3d> path;
  for (std::size_t i = 0; i < poses; ++i) {
    const double turns = static_cast<double>(poses) / kAround;
    const double small = 2.0 * kPi * static_cast<double>(i % kAround) / kAround;
    const double large = 2.0 * kPi * static_cast<double>(i) / static_cast<double>(poses);
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.rotate(Eigen::AngleAxisd(large, Eigen::Vector3d::UnitZ()));
    pose.translate(Eigen::Vector3d(2.0 + 0.03 * turns, 0.0, 0.0));
    pose.rotate(Eigen::AngleAxisd(small, Eigen::Vector3d::UnitY()));
    pose.translate(Eigen::Vector3d(2.0, 0.0, 0.0));
    path.push_back(pose);
  }
  BenchGraph out = walk(rng, {path}, kTorusSigmaM, kTorusSigmaRad);
  out.name = "torus " + std::to_string(poses);
  for (std::size_t i = kAround; i < poses; ++i) {
    const Key a = i - kAround;
    out.graph.add_edge(measured(rng, a, i, path[a].inverse() * path[i], EdgeKind::kLoopClosure, kTorusSigmaM,
                                kTorusSigmaRad));
    out.is_false.push_back(false);
  }
  return out;
}

void add_false_groups(BenchGraph& graph, std::size_t groups, std::size_t size, std::uint64_t seed) {
  Rng rng(seed);
  // Relative poses within a stretch are those of the odometry, as in a parallel tunnel.
  const std::vector<Eigen::Isometry3d> poses = initial_poses(graph.graph, Initialization::kOdometry);
  const Matrix6d information = graph.graph.edges().back().information;
  const double noise = noise_of_closures(graph);
  for (std::size_t g = 0; g < groups; ++g) {
    const std::size_t a = rng.below(poses.size() - size), b = rng.below(poses.size() - size);
    if (a < b + 2 * size && b < a + 2 * size) {
      --g;
      continue;
    }
    const Eigen::Isometry3d start =
        pose_at({rng.uniform(-1.0, 1.0), rng.uniform(-1.0, 1.0), 0.0}, rng.uniform(-0.3, 0.3));
    for (std::size_t i = 0; i < size; ++i) {
      const Eigen::Isometry3d T =
          poses[a + i].inverse() * poses[a] * start * poses[b].inverse() * poses[b + i];
      graph.graph.add_edge(measured_with(rng, graph.graph.nodes()[a + i].key, graph.graph.nodes()[b + i].key,
                                         T, EdgeKind::kLoopClosure, information, noise));
      graph.is_false.push_back(true);
    }
  }
}

void add_random_false(BenchGraph& graph, std::size_t count, std::uint64_t seed) {
  Rng rng(seed);
  const std::size_t nodes = graph.graph.nodes().size();
  const Matrix6d last = graph.graph.edges().back().information;
  for (std::size_t i = 0; i < count; ++i) {
    Edge edge;
    const std::size_t a = rng.below(nodes), b = (a + 2 + rng.below(nodes - 3)) % nodes;
    edge.from = graph.graph.nodes()[a].key;
    edge.to = graph.graph.nodes()[b].key;
    const Eigen::Vector3d axis(rng.normal(), rng.normal(), rng.normal());
    edge.T_from_to.linear() = se3::so3_exp(rng.uniform(0.0, 3.0) * axis.normalized());
    edge.T_from_to.translation() =
        Eigen::Vector3d(rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0), rng.uniform(-5.0, 5.0));
    edge.information = last;
    graph.graph.add_edge(edge);
    graph.is_false.push_back(true);
  }
}

}  // namespace loopwise::bench
