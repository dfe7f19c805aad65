// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/generation/proximity.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {
namespace {

double radius_bound(const ProximityOptions& options) {
  if (options.radius_max_m > 0.0) return options.radius_max_m;
  return std::numeric_limits<double>::infinity();
}

/// The search radius for two nodes whose indices differ by `indices`.
double radius_after(const ProximityOptions& options, double indices) {
  const double most = radius_bound(options);
  return std::clamp(options.rate_m * indices, std::min(options.radius_min_m, most), most);
}

struct Preset {
  std::string_view name;
  ProximityOptions options;
};

const std::vector<Preset>& presets() {
  static const std::vector<Preset> all{
      {"paper", {0.2, 0.0, 0.0, 0, 0, 0.0}},
      {"lamp_2022_01", {0.2, 0.0, 30.0, 10, 10}},
      {"lamp_base", {0.2, 30.0, 30.0, 10, 0}},
      {"lamp_robot", {0.2, 5.0, 80.0, 15, 3}},
  };
  return all;
}

}  // namespace

void validate_proximity(const ProximityOptions& options) {
  validate(options);
  const bool is_default = options.radius_min_m == ProximityOptions().radius_min_m;
  if (!is_default && options.radius_min_m > radius_bound(options)) {
    throw OptionError("radius_min_m = " + std::to_string(options.radius_min_m) +
                      ", must be <= radius_max_m = " + std::to_string(options.radius_max_m) +
                      ": set both for a larger radius");
  }
}

ProximityOptions proximity_preset(std::string_view name) {
  std::string known;
  for (const Preset& preset : presets()) {
    if (preset.name == name) return preset.options;
    known += (known.empty() ? "" : ", ") + std::string(preset.name);
  }
  throw OptionError("preset = \"" + std::string(name) + "\", must be one of: " + known);
}

std::vector<std::string> proximity_preset_names() {
  std::vector<std::string> names;
  for (const Preset& preset : presets()) names.emplace_back(preset.name);
  return names;
}

std::size_t ProximityGenerator::CellHash::operator()(const Cell& cell) const {
  const auto word = [](int i) { return static_cast<std::uint64_t>(static_cast<std::uint32_t>(i)); };
  return static_cast<std::size_t>(mix64(word(cell.x()) | word(cell.y()) << 32) ^ mix64(word(cell.z()) + 1));
}

ProximityGenerator::ProximityGenerator(const ProximityOptions& options, Robots robots)
    : options_(options),
      robots_(std::move(robots)),
      highest_index_(robots_.size(), 0),
      path_(robots_.size()),
      left_out_(robots_.size()) {
  validate_proximity(options_);
  // About a quarter of the largest radius: a search visits few cells and few nodes outside the radius.
  constexpr double kFewestMetres = 2.0, kMostMetres = 20.0;
  cell_m_ = std::clamp(0.25 * radius_bound(options_), kFewestMetres, kMostMetres);
}

ProximityGenerator::Cell ProximityGenerator::cell_of(const Eigen::Vector3d& position) const {
  constexpr double kLimit = 1e9;  // far beyond any mission; keeps the cast defined
  return (position / cell_m_).array().floor().cwiseMax(-kLimit).cwiseMin(kLimit).cast<int>();
}

double ProximityGenerator::radius(const Entry& entry, const Entry& other) const {
  double indices = static_cast<double>(entry.index);
  if (entry.robot == other.robot) indices = std::abs(indices - static_cast<double>(other.index));
  return radius_after(options_, indices);
}

void ProximityGenerator::collect(const Entry& entry, std::size_t own, const std::vector<std::size_t>& numbers,
                                 std::vector<std::pair<double, std::size_t>>& found) const {
  for (const std::size_t number : numbers) {
    const Entry& other = entries_[number];
    if (other.key == entry.key) continue;
    if (entry.robot == other.robot) {
      const std::uint64_t gap = std::max(entry.index, other.index) - std::min(entry.index, other.index);
      if (gap < static_cast<std::uint64_t>(options_.skip_recent)) continue;
    }
    const double distance = (entry.position - other.position).norm();
    const bool later = own > number;
    if (distance <= radius(later ? entry : other, later ? other : entry))
      found.emplace_back(distance, number);
  }
}

std::vector<LoopCandidate> ProximityGenerator::near(const Entry& entry, std::size_t own, std::uint64_t most,
                                                    double time_s) const {
  const double reach = radius_after(options_, static_cast<double>(most));
  const double cells = std::pow(2.0 * std::ceil(reach / cell_m_) + 1.0, 3);

  std::vector<std::pair<double, std::size_t>> found;
  if (cells > static_cast<double>(grid_.size())) {
    std::vector<std::size_t> all(entries_.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    collect(entry, own, all, found);
  } else {
    const Eigen::Vector3d corner = Eigen::Vector3d::Constant(reach);
    const Cell low = cell_of(entry.position - corner), high = cell_of(entry.position + corner);
    for (int x = low.x(); x <= high.x(); ++x) {
      for (int y = low.y(); y <= high.y(); ++y) {
        for (int z = low.z(); z <= high.z(); ++z) {
          const auto cell = grid_.find(Cell(x, y, z));
          if (cell != grid_.end()) collect(entry, own, cell->second, found);
        }
      }
    }
  }

  if (const auto most_wanted = static_cast<std::size_t>(options_.n_closest);
      most_wanted > 0 && found.size() > most_wanted) {
    std::sort(found.begin(), found.end());
    found.resize(most_wanted);
  }
  std::sort(found.begin(), found.end(), [](const auto& a, const auto& b) { return a.second < b.second; });

  std::vector<LoopCandidate> candidates;
  candidates.reserve(found.size());
  for (const auto& [distance, number] : found) {
    LoopCandidate candidate;
    candidate.from = entry.key;
    candidate.to = entries_[number].key;
    candidate.source = CandidateSource::kProximity;
    candidate.time_s = time_s;
    candidate.distance_m = distance;
    candidates.push_back(candidate);
  }
  return candidates;
}

bool ProximityGenerator::takes_part(const PoseGraph& graph, Key key) const {
  if (options_.spacing_m <= 0.0) return true;
  const std::map<std::uint64_t, Key>& path = path_[robots_.of(key)];
  const Eigen::Isometry3d& pose = graph.node(key).pose;
  const auto far_from = [&](Key other) {
    const Eigen::Isometry3d step = graph.node(other).pose.inverse() * pose;
    return step.translation().norm() >= options_.spacing_m ||
           se3::rotation_angle(step) >= options_.spacing_rad;
  };
  const auto after = path.lower_bound(robots_.node_index(key));
  return (after == path.end() || far_from(after->second)) &&
         (after == path.begin() || far_from(std::prev(after)->second));
}

std::vector<LoopCandidate> ProximityGenerator::on_node(const PoseGraph& graph, Key key, double time_s) {
  if (robots_.is_landmark(key)) return {};
  if (takes_part(graph, key)) return add_participant(graph, key, time_s);
  left_out_[robots_.of(key)].emplace(robots_.node_index(key), key);
  return {};
}

std::vector<LoopCandidate> ProximityGenerator::add_participant(const PoseGraph& graph, Key key,
                                                               double time_s) {
  const Entry entry{key, robots_.of(key), robots_.node_index(key), graph.node(key).pose.translation()};
  // The largest radius of any older node bounds the visited cells. Within one robot the index gap can exceed
  // the node's own index if nodes arrive out of order.
  const std::uint64_t most = std::max(entry.index, highest_index_[entry.robot]);
  std::vector<LoopCandidate> candidates = near(entry, entries_.size(), most, time_s);
  highest_index_[entry.robot] = most;
  const std::size_t number = entries_.size();
  entries_.push_back(entry);
  try {
    number_of_[key] = number;
    path_[entry.robot][entry.index] = key;
    grid_[cell_of(entry.position)].push_back(number);
  } catch (...) {  // restore the state before the node
    number_of_.erase(key);
    path_[entry.robot].erase(entry.index);
    entries_.pop_back();
    throw;
  }
  return candidates;
}

std::vector<LoopCandidate> ProximityGenerator::on_moved(const PoseGraph& graph, const std::vector<Key>& keys,
                                                        double time_s) {
  for (const Key key : keys) {
    const auto own = number_of_.find(key);
    if (own == number_of_.end()) continue;
    Entry& entry = entries_[own->second];
    std::vector<std::size_t>& cell = grid_[cell_of(entry.position)];
    cell.erase(std::remove(cell.begin(), cell.end(), own->second), cell.end());
    entry.position = graph.node(key).pose.translation();
    grid_[cell_of(entry.position)].push_back(own->second);
  }
  std::uint64_t most = 0;
  for (const std::uint64_t index : highest_index_) most = std::max(most, index);
  std::vector<LoopCandidate> candidates;
  for (const Key key : keys) {
    const auto own = number_of_.find(key);
    if (own == number_of_.end()) continue;
    for (LoopCandidate& candidate : near(entries_[own->second], own->second, most, time_s)) {
      if (number_of_.at(candidate.to) > own->second) std::swap(candidate.from, candidate.to);
      candidates.push_back(candidate);
    }
  }
  std::map<std::size_t, std::pair<std::uint64_t, std::uint64_t>> moved;  // by robot: first and last index
  for (const Key key : keys) {
    if (robots_.is_landmark(key)) continue;
    const std::uint64_t index = robots_.node_index(key);
    const auto [range, first] = moved.try_emplace(robots_.of(key), index, index);
    if (!first) range->second = {std::min(range->second.first, index), std::max(range->second.second, index)};
  }
  for (const auto& [robot, range] : moved) {
    // The candidates to take part now are between the nodes before and after the moved ones.
    const std::map<std::uint64_t, Key>& path = path_[robot];
    const auto before = path.lower_bound(range.first), after = path.upper_bound(range.second);
    const std::uint64_t begin = before == path.begin() ? 0 : std::prev(before)->first;
    auto end = after == path.end() ? left_out_[robot].end() : left_out_[robot].lower_bound(after->first);
    for (auto other = left_out_[robot].lower_bound(begin); other != end;) {
      if (!takes_part(graph, other->second)) {
        ++other;
        continue;
      }
      const std::vector<LoopCandidate> own = add_participant(graph, other->second, time_s);
      candidates.insert(candidates.end(), own.begin(), own.end());
      other = left_out_[robot].erase(other);
    }
  }
  return candidates;
}

void ProximityGenerator::on_graph(const PoseGraph& graph) {
  grid_.clear();
  for (std::size_t number = 0; number < entries_.size(); ++number) {
    Entry& entry = entries_[number];
    if (const auto node = graph.find(entry.key)) entry.position = graph.nodes()[*node].pose.translation();
    grid_[cell_of(entry.position)].push_back(number);
  }
}

}  // namespace loopwise
