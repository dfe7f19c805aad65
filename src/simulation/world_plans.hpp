// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Plans of the worlds: positions of passages and rooms.
#pragma once

#include <cstddef>
#include <map>
#include <utility>
#include <vector>

#include "world_builder.hpp"

namespace loopwise::simulation_detail {

/// Places by (column, row).
using PlaceGrid = std::map<std::pair<int, int>, std::size_t>;

// ---- coal mine

/// Style of an entry with random sizes.
[[nodiscard]] Style entry_style(Builder& builder);
/// Distances along an entry at which cross-cuts leave it; the last is `length`.
[[nodiscard]] std::vector<double> cross_cuts(Rng& rng, double length);
/// Adds parallel entries in the direction `along` from `start`, at the distance `across`, joined by
/// cross-cuts. `first` has the places where the entries begin, and gets them if it is empty. \returns the
/// places at the ends
std::vector<std::size_t> parallel_entries(Builder& builder, const Eigen::Vector2d& start,
                                          const Eigen::Vector2d& along, const Eigen::Vector2d& across,
                                          std::vector<std::size_t> first, const std::vector<double>& cuts,
                                          std::size_t count,
                                          std::vector<std::vector<std::size_t>>* places = nullptr);
/// Adds pipes, props and boxes along all existing passages.
void furnish_entries(Builder& builder);
/// A whole coal mine with passages of about `target` metres.
void plan_tunnel(Builder& builder, double target);

// ---- lattices

/// A whole limestone mine.
void plan_mine(Builder& builder, double target);
/// A cave whose entrance is at `origin`, within rows `j_low` to `j_high` of its lattice.
PlaceGrid plan_cave(Builder& builder, const Eigen::Vector2d& origin, double target, int j_low, int j_high);

// ---- power plant

/// Plans one building from its south-west corner: corridors on a grid with rooms and halls between them, on
/// `floors` storeys. \returns the corridor places of the ground floor
PlaceGrid plan_building(Builder& builder, const Eigen::Vector2d& corner, int columns, int rows, int floors);

}  // namespace loopwise::simulation_detail
