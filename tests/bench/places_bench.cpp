// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// How well places are recognised, and how fast:
///   loopwise_places_bench [--radius M] [--apart M] [--crowd N] [--cell M] [--path M] [--range M]
///   MISSION[,MISSION…] …
/// Missions by commas are joined. Nodes a metre apart are places, with submaps of the scans around them. Each
/// is sought among the places of other robots and of its own that lie at least --apart along the path away. A
/// match is right within --radius of it, by the truth where the mission has one, else by odometry. Nodes
/// without any such place say nothing of recall, but what is found for them is wrong. A guess is right within
/// 2 m and 0.1 rad. --crowd adds as many stretched places of the same missions, which are never matches that
/// count, to measure time.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/features/place.hpp>
#include <loopwise/features/voxel_grid.hpp>
#include <loopwise/generation/place_submap.hpp>
#include <loopwise/io/mission.hpp>

namespace loopwise::bench {
namespace {

/// Processor time, so that other work on the machine does not count.
class CpuTime {
 public:
  [[nodiscard]] double ms() const {
    return 1e3 * static_cast<double>(std::clock() - begin_) / CLOCKS_PER_SEC;
  }

 private:
  std::clock_t begin_ = std::clock();
};

struct Settings {
  double radius_m = 10.0, apart_m = 25.0;
  std::size_t crowd = 0;
  PlaceSubmapOptions submap;
  DensityPlaceOptions density;
};

struct Place {
  Key key = 0;
  std::size_t robot = 0;
  double path_m = 0.0;  // driven by its robot until here
  Eigen::Isometry3d pose;
  PlaceSubmap submap;
};

std::vector<Place> places_of(const Mission& mission, const Settings& settings) {
  std::map<Key, std::shared_ptr<const PointCloud>> kept;
  const ScanLoader scans = [&](Key key) -> std::shared_ptr<const PointCloud> {
    auto& cloud = kept[key];
    if (!cloud) {
      if (const auto raw = mission.scans->load(key))
        cloud = std::make_shared<PointCloud>(voxel_downsample(*raw, 0.25));
    }
    return cloud;
  };
  std::vector<Key> keys;
  for (const Node& node : mission.graph.nodes()) {
    if (!mission.robots.is_landmark(node.key)) keys.push_back(node.key);
  }
  std::sort(keys.begin(), keys.end());
  std::vector<Place> places;
  std::map<std::size_t, std::pair<double, Eigen::Vector3d>> driven;
  std::map<std::size_t, double> last;
  for (const Key key : keys) {
    Place place;
    place.key = key;
    place.robot = mission.robots.of(key);
    const Eigen::Isometry3d& pose = mission.graph.node(key).pose;
    const auto [so_far, first] = driven.try_emplace(place.robot, 0.0, pose.translation());
    so_far->second.first += (pose.translation() - so_far->second.second).norm();
    so_far->second.second = pose.translation();
    place.path_m = so_far->second.first;
    if (!first && place.path_m - last[place.robot] < 1.0) continue;
    last[place.robot] = place.path_m;
    const auto truth = mission.ground_truth.find(key);
    place.pose = truth == mission.ground_truth.end() ? pose : truth->second;
    place.submap = place_submap(mission.graph, mission.robots, key, scans, settings.submap);
    if (!place.submap.level.empty()) places.push_back(std::move(place));
  }
  return places;
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  const auto at = static_cast<std::size_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(at), values.end());
  return values[at];
}

/// Places that look similar to those of the mission but do not exist: stretched and mirrored.
void add_crowd(PlaceDatabase& database, const std::vector<Place>& places, std::size_t count) {
  Rng rng(1);
  for (std::size_t i = 0; i < count; ++i) {
    PointCloud cloud = places[i % places.size()].submap.level;
    const auto sx = static_cast<float>(rng.uniform(0.6, 1.6)),
               sy = static_cast<float>(-rng.uniform(0.6, 1.6));
    for (Eigen::Vector3f& point : cloud.points)
      point = Eigen::Vector3f(sx * point.x(), sy * point.y(), point.z());
    database.add(make_key('Z', i), cloud);
  }
}

void measure(const std::string& name, const std::vector<Place>& places, PlaceDatabase& database,
             const Settings& settings) {
  const CpuTime describing;
  for (const Place& place : places) database.add(place.key, place.submap.level);
  const double describe_ms = describing.ms() / static_cast<double>(places.size());
  add_crowd(database, places, settings.crowd);
  std::map<Key, const Place*> by_key;
  for (const Place& place : places) by_key[place.key] = &place;
  std::size_t sought = 0, found[3] = {0, 0, 0};
  const std::size_t ranks[3] = {1, 5, 10};
  std::size_t placed = 0;
  std::vector<double> errors_m, errors_rad, nees, right, wrong, times;
  for (const Place& place : places) {
    const auto eligible = [&](const Place& other) {
      return other.robot != place.robot || std::abs(other.path_m - place.path_m) >= settings.apart_m;
    };
    const auto is_right = [&](const Place& other) {
      return (other.pose.translation() - place.pose.translation()).norm() <= settings.radius_m;
    };
    const bool known = std::any_of(places.begin(), places.end(),
                                   [&](const Place& other) { return eligible(other) && is_right(other); });
    const CpuTime watch;
    const auto matches = database.query(place.key, 10, [&](Key key) {
      const auto other = by_key.find(key);
      return other != by_key.end() && eligible(*other->second);
    });
    times.push_back(watch.ms());
    if (known) ++sought;
    std::size_t first = 10;
    for (std::size_t i = 0; i < matches.size(); ++i) {
      const Place& other = *by_key.at(matches[i].key);
      if (i == 0) (is_right(other) ? right : wrong).push_back(matches[i].similarity);
      if (is_right(other)) first = std::min(first, i);
      if (i != first && i != 0) continue;
      const PlaceMatch guess = between_bodies(matches[i], place.submap.rotation, other.submap.rotation);
      const Vector6d error = se3::log(guess.T_query_match.inverse() * place.pose.inverse() * other.pose);
      if (i == 0 && known && error.head<2>().norm() < 2.0 && std::abs(error[5]) < 0.1) ++placed;
      if (i != first) continue;
      errors_m.push_back(error.head<2>().norm());
      errors_rad.push_back(std::abs(error[5]));
      nees.push_back(error.dot(guess.covariance.inverse() * error));
    }
    for (int r = 0; r < 3; ++r) found[r] += known && first < ranks[r] ? 1 : 0;
  }
  const auto share = [&](std::size_t n) {
    return 100.0 * static_cast<double>(n) / static_cast<double>(sought);
  };
  std::printf(
      "| %s | %s | %zu | %zu | %.1f | %.1f | %.1f | %.1f | %.2f / %.2f | %.1f / %.1f | %.1f | %.2f / %.2f | "
      "%.1f | "
      "%.2f / %.2f |\n",
      name.c_str(), std::string(database.name()).c_str(), places.size(), sought, share(found[0]),
      share(found[1]), share(found[2]), share(placed), quantile(errors_m, 0.5), quantile(errors_m, 0.9),
      57.3 * quantile(errors_rad, 0.5), 57.3 * quantile(errors_rad, 0.9), quantile(nees, 0.5),
      quantile(right, 0.1), quantile(wrong, 0.9), describe_ms, quantile(times, 0.5), quantile(times, 0.95));
  std::fflush(stdout);
}

void run(const std::string& source, const Settings& settings) {
  std::vector<std::filesystem::path> paths;
  std::istringstream parts(source);
  std::string name;
  for (std::string part; std::getline(parts, part, ',');) {
    paths.emplace_back(part);
    name += (name.empty() ? "" : " + ") + paths.back().filename().string();
  }
  const Mission mission = read_missions(paths);
  const CpuTime watch;
  const std::vector<Place> places = places_of(mission, settings);
  std::fprintf(stderr, "%s: %.1f ms a submap\n", name.c_str(),
               watch.ms() / static_cast<double>(places.size()));
  if (places.empty()) return;
  const auto context = make_scan_context_database();
  measure(name, places, *context, settings);
  const auto density = make_density_place_database(settings.density);
  measure(name, places, *density, settings);
}

}  // namespace
}  // namespace loopwise::bench

int main(int argc, char** argv) {
  loopwise::bench::Settings settings;
  const std::map<std::string, double*> numbers{{"--radius", &settings.radius_m},
                                               {"--apart", &settings.apart_m},
                                               {"--cell", &settings.density.cell_m},
                                               {"--range", &settings.density.range_m},
                                               {"--path", &settings.submap.path_m}};
  try {
    std::puts(
        "| mission | descriptor | places | sought | recall@1 % | @5 | @10 | guess@1 right % | xy error m, "
        "50/90 % | yaw ° | "
        "NEES "
        "of 6 | similarity right 10 % / wrong 90 % | describe ms | search ms, 50/95 % |\n"
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    for (int i = 1; i < argc; ++i) {
      const auto number = numbers.find(argv[i]);
      if (number != numbers.end() && i + 1 < argc) {
        *number->second = std::atof(argv[++i]);
      } else if (std::strcmp(argv[i], "--crowd") == 0 && i + 1 < argc) {
        settings.crowd = static_cast<std::size_t>(std::atoi(argv[++i]));
      } else {
        loopwise::bench::run(argv[i], settings);
      }
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
