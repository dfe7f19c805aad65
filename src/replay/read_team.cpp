// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/read_team.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/features/place.hpp>
#include <loopwise/generation/place_submap.hpp>
#include <loopwise/io/place_parts.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise {
namespace {

constexpr const char* kWithoutFrame = "joined without a frame";

/// Number of each robot's component; nothing for landmarks.
std::vector<std::optional<std::size_t>> component_of_robot(const Mission& mission) {
  std::map<std::size_t, std::size_t> number;  // component number, by source
  std::vector<std::optional<std::size_t>> out(mission.robots.size());
  std::set<std::size_t> present;
  for (const Node& node : mission.graph.nodes()) present.insert(mission.robots.of(node.key));
  std::size_t count = 0;
  for (std::size_t r = 0; r < mission.robots.size(); ++r) {
    if (mission.robots[r].landmarks || present.count(r) == 0) continue;
    if (mission.robot_sources.empty()) {
      out[r] = count++;
      continue;
    }
    const auto [entry, is_new] = number.emplace(mission.robot_sources[r], count);
    if (is_new) ++count;
    out[r] = entry->second;
  }
  return out;
}

Problems without(const Problems& problems, const std::set<std::string>& kinds) {
  Problems out;
  for (const Problem& problem : problems.all()) {
    if (kinds.count(problem.kind) != 0) continue;
    if (problem.altered) {
      out.add_altered(problem.kind, problem.example, problem.count);
    } else {
      out.add(problem.kind, problem.example, problem.count);
    }
  }
  return out;
}

/// Key frames at least a metre apart: closer ones see the same place.
std::vector<Key> thinned(const PoseGraph& graph, const std::vector<Key>& keys) {
  constexpr double kApart_m = 1.0;
  std::vector<Key> out;
  for (const Key key : keys) {
    const bool far =
        out.empty() ||
        (graph.node(key).pose.translation() - graph.node(out.back()).pose.translation()).norm() >= kApart_m;
    if (far) out.push_back(key);
  }
  return out;
}

/// A key frame with its description for place recognition.
struct DescribedPlace {
  Key key = 0;
  std::size_t component = 0;
  std::shared_ptr<const PlaceDescriptor> descriptor;
};

std::vector<DescribedPlace> described_places(const Mission& mission,
                                             const std::vector<JoinComponent>& components,
                                             const PlaceDatabase& database, FeatureCache& features,
                                             ThreadPool& threads, const ProgressCallback& progress,
                                             const StopToken& stop) {
  std::vector<DescribedPlace> places;
  for (std::size_t c = 0; c < components.size(); ++c) {
    for (const Key key : thinned(mission.graph, components[c].keys)) places.push_back({key, c, nullptr});
  }
  const ScanLoader scans = [&features](Key key) -> std::shared_ptr<const PointCloud> {
    const std::shared_ptr<const ScanFeatures> of = features.get(key);
    return of ? std::shared_ptr<const PointCloud>(of, &of->cloud) : nullptr;
  };
  constexpr std::size_t kBatch = 64;
  for (std::size_t begin = 0; begin < places.size() && !stop.stop_requested(); begin += kBatch) {
    threads.for_each(std::min(kBatch, places.size() - begin), [&](std::size_t i) {
      DescribedPlace& place = places[begin + i];
      try {
        place.descriptor =
            database.describe(place_submap(mission.graph, mission.robots, place.key, scans).level);
      } catch (const Error&) {
        // A scan that cannot be read proposes no pairs. The scan store counts it.
      }
    });
    if (progress) progress({"describing places", std::min(places.size(), begin + kBatch), places.size(), ""});
  }
  return places;
}

/// Pairs of similar key frames from different components.
std::vector<ProposedPair> proposed_pairs(const Mission& mission, const std::vector<JoinComponent>& components,
                                         FeatureCache& features, std::size_t count, ThreadPool& threads,
                                         const ProgressCallback& progress, const StopToken& stop) {
  if (count == 0) return {};
  const std::unique_ptr<PlaceDatabase> database = make_scan_context_database();
  const std::vector<DescribedPlace> places =
      described_places(mission, components, *database, features, threads, progress, stop);
  std::map<Key, std::size_t> component_of;
  for (const DescribedPlace& place : places) {
    if (!place.descriptor) continue;
    database->insert(place.key, place.descriptor);
    component_of[place.key] = place.component;
  }
  std::vector<std::vector<ProposedPair>> found(places.size());
  threads.for_each(places.size(), [&](std::size_t i) {
    if (!places[i].descriptor || stop.stop_requested()) return;
    for (std::size_t other = 0; other < components.size(); ++other) {
      if (other == places[i].component) continue;
      const auto of_other = [&](Key key) { return component_of.at(key) == other; };
      for (const PlaceMatch& match : database->search(*places[i].descriptor, count, of_other))
        found[i].push_back({places[i].key, match.key, match.similarity});
    }
  });
  std::vector<ProposedPair> pairs;
  for (const auto& some : found) pairs.insert(pairs.end(), some.begin(), some.end());
  return pairs;
}

}  // namespace

std::vector<JoinComponent> frames_to_find(const Mission& mission) {
  const auto component_of = component_of_robot(mission);
  std::vector<JoinComponent> components;
  for (const auto& number : component_of) {
    if (number) components.resize(std::max(components.size(), *number + 1));
  }
  for (std::size_t r = 0; r < component_of.size(); ++r) {
    if (!component_of[r]) continue;
    std::string& name = components[*component_of[r]].name;
    name += (name.empty() ? "" : "+") + mission.robots[r].name;
  }
  for (const std::vector<Key>& path : robot_paths(mission.graph, mission.robots)) {
    for (const Key key : path) {
      if (!mission.scans->has(key)) continue;
      components[*component_of[mission.robots.of(key)]].keys.push_back(key);
    }
  }
  return components;
}

TeamFrames find_team_frames(const Mission& mission, const Config& config, ThreadPool& threads,
                            const ProgressCallback& progress, const StopToken& stop) {
  TeamFrames out;
  out.components = frames_to_find(mission);
  if (out.components.size() < 2) {
    throw InputError(
        mission.path.string() +
        ": has only one robot, so there are no frames to find; several sources, or robots, are needed");
  }
  for (const JoinComponent& component : out.components) {
    if (!component.keys.empty()) continue;
    throw InputError(component.name +
                     ": has no scans, so its frame cannot be found from them; --frames FILE gives it");
  }
  const Registration registration = make_registration(config.replay.registration, mission.scans->loader());
  const std::vector<ProposedPair> pairs =
      proposed_pairs(mission, out.components, *registration.features,
                     static_cast<std::size_t>(config.joining.proposals), threads, progress, stop);
  out.result = find_frames(mission.graph, mission.robots, out.components, pairs, *registration.registrar,
                           threads, config.joining, progress, stop);
  if (out.result.stopped) throw StoppedError("stopped while searching the frames of the sources");
  return out;
}

Mission placed_team(const Mission& mission, const TeamFrames& frames) {
  const JoinResult& result = frames.result;
  const auto component_of = component_of_robot(mission);
  std::map<std::size_t, MissionPart> parts;  // by component
  for (std::size_t r = 0; r < component_of.size(); ++r) {
    if (component_of[r] && result.frames[*component_of[r]].group == 0)
      parts[*component_of[r]].robots.push_back(r);
  }
  if (parts.size() < 2) {
    throw InputError(to_string(result, frames.components) +
                     "; --frames FILE gives the frames, --frames common uses the poses unchanged");
  }
  constexpr double kWider = 10.0;
  std::vector<MissionPart> placed;
  for (auto& [component, part] : parts) {
    const ComponentFrame& frame = result.frames[component];
    part.T_common_part = frame.pose;
    if (component != parts.begin()->first) {
      std::array<double, 6> sigmas{};
      for (int i = 0; i < 6; ++i)
        sigmas[static_cast<std::size_t>(i)] = kWider * std::sqrt(frame.covariance(i, i));
      part.sigmas = sigmas;
    }
    placed.push_back(std::move(part));
  }
  std::vector<LoopClosure> closures;
  for (const Tie& tie : result.ties) {
    if (tie.joined && result.frames[tie.a].group == 0)
      closures.insert(closures.end(), tie.closures.begin(), tie.closures.end());
  }
  Mission out = place_parts(mission, placed, closures, /*move_truth=*/!mission.robot_sources.empty());
  out.problems = without(out.problems, {kWithoutFrame, "no prior given"});
  return out;
}

Team read_team(const std::vector<std::filesystem::path>& paths, const Config& config, bool find,
               ThreadPool& threads, const ProgressCallback& progress, const StopToken& stop) {
  MissionOptions options = config.mission;
  const bool wanted = options.frames == "auto", in_common_frame = options.frames == "common";
  if (wanted || in_common_frame) options.frames.clear();
  Team team;
  team.mission = read_missions(paths, options, progress, stop);
  const bool apart = team.mission.problems.count(kWithoutFrame) > 0;
  if (in_common_frame) team.mission.problems = without(team.mission.problems, {kWithoutFrame});
  if (wanted || (find && !in_common_frame && apart && !team.mission.scans->empty())) {
    team.frames = find_team_frames(team.mission, config, threads, progress, stop);
    team.mission = placed_team(team.mission, *team.frames);
  }
  return team;
}

}  // namespace loopwise
