// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Pose graphs for benchmarks: read from g2o, or generated from a seed.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <loopwise/core/pose_graph.hpp>

namespace loopwise::bench {

struct BenchGraph {
  std::string name;
  PoseGraph graph;             ///< Poses from the file, or chained along the noisy odometry.
  std::vector<bool> is_false;  ///< By edge.
};

/// A g2o graph with consecutive ids as odometry, priors of sigma 1e-4 on node 0 (and 625 in a tunnel1250),
/// labels from the file of the same name ending in .labels where there is one.
[[nodiscard]] BenchGraph read_bench_graph(const std::filesystem::path& path);

/// The g2o files of a folder in the order of their names, without those of true poses.
[[nodiscard]] std::vector<std::filesystem::path> g2o_files(const std::string& folder);

/// Robots that walk the streets of a square grid (2 m a step, noise 0.02 m and 0.005 rad) with closures
/// between poses at most a street's width apart. `robots` = 1 and few closures give a chain.
[[nodiscard]] BenchGraph streets(std::size_t poses, std::size_t closures, std::size_t robots,
                                 std::uint64_t seed);

/// A lattice of poses in three dimensions walked row by row, with closures between neighbours.
[[nodiscard]] BenchGraph lattice(std::size_t poses, std::uint64_t seed);

/// A square grid of poses in the plane z = 0 walked row by row, with closures between adjacent rows.
[[nodiscard]] BenchGraph grid(std::size_t poses, std::uint64_t seed);

/// A robot that walks the corridors of one small floor again and again with odometry that is useless over the
/// whole (0.1 m and 0.05 rad a step of 1 m). Closures join random pairs of visits of a place, so that few
/// have others near them. Their information differs by a factor of up to 100 and couples all directions.
[[nodiscard]] BenchGraph rooms(std::size_t poses, std::size_t closures, std::uint64_t seed);

/// A path wound around a torus in steps as long as the odometry's noise (0.13 m, 0.1 m and 0.05 rad), with
/// closures to the turn before: chained odometry says nothing of places 100 steps away.
[[nodiscard]] BenchGraph torus(std::size_t poses, std::uint64_t seed);

/// Adds `groups` sets of `size` false closures that agree with each other: a stretch of the path taken for
/// another. They have the information of the last edge, and noise as large as that of the closures.
void add_false_groups(BenchGraph& graph, std::size_t groups, std::size_t size, std::uint64_t seed);

/// Adds closures between random nodes with random relative poses and the information of the last edge.
void add_random_false(BenchGraph& graph, std::size_t count, std::uint64_t seed);

}  // namespace loopwise::bench
