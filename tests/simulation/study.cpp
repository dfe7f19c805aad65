// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Figures and pictures of docs/simulation.md that need more than the command line offers:
///
///     loopwise_simulation_study pictures FOLDER         plans and cross-sections of the worlds, as PPM
///     loopwise_simulation_study registration SEEDS      how registration fares on true neighbours and on
///                                                       parallel corridors
///     loopwise_simulation_study sessions FOLDER         the same on consecutive scans of a recorded session
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <map>
#include <string>
#include <vector>

#include <loopwise/core/random.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/task.hpp>
#include <loopwise/simulation/ray_caster.hpp>
#include <loopwise/simulation/simulate.hpp>

#include "lidar.hpp"

using namespace loopwise;

namespace {

// ---- pictures

struct Picture {
  int width, height;
  std::vector<unsigned char> rgb;
  Picture(int w, int h, unsigned char grey)
      : width(w), height(h), rgb(static_cast<std::size_t>(w) * static_cast<std::size_t>(h) * 3, grey) {}
  void set(int x, int y, unsigned char r, unsigned char g, unsigned char b) {
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    unsigned char* p =
        &rgb[(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)) *
             3];
    p[0] = r;
    p[1] = g;
    p[2] = b;
  }
  void write(const std::string& path) const {
    std::ofstream out(path, std::ios::binary);
    out << "P6\n" << width << " " << height << "\n255\n";
    out.write(reinterpret_cast<const char*>(rgb.data()), static_cast<std::streamsize>(rgb.size()));
    if (!out) throw IoError(path, "cannot be written");
  }
};

unsigned char grey_level(float x) {
  return static_cast<unsigned char>(std::clamp(x, 0.0F, 255.0F));
}

/// The world from above, without the rock above `ceiling` metres over z = 0: floors and objects shaded by
/// slope, paths in red. Void and rock alternate along a vertical ray.
Picture plan(const World& world, float pixels_per_metre, float ceiling) {
  Eigen::Vector3f low = world.mesh.vertices.front(), high = low;
  for (const Eigen::Vector3f& v : world.mesh.vertices) {
    low = low.cwiseMin(v);
    high = high.cwiseMax(v);
  }
  const RayCaster caster(world.mesh);
  Picture picture(static_cast<int>((high.x() - low.x()) * pixels_per_metre) + 1,
                  static_cast<int>((high.y() - low.y()) * pixels_per_metre) + 1, 30);
  for (int j = 0; j < picture.height; ++j) {
    for (int i = 0; i < picture.width; ++i) {
      Eigen::Vector3f p(low.x() + (static_cast<float>(i) + 0.5F) / pixels_per_metre,
                        high.y() - (static_cast<float>(j) + 0.5F) / pixels_per_metre, high.z() + 5.0F);
      std::optional<RayHit> floor;
      for (int hits = 1; hits <= 20; ++hits) {
        const auto hit = caster.cast(p, {0.0F, 0.0F, -1.0F}, 200.0F);
        if (!hit) break;
        p.z() -= hit->distance_m + 0.02F;
        if (hits % 2 == 0 && p.z() < ceiling) {
          floor = hit;
          break;
        }
      }
      if (!floor) continue;
      // Under the top of a thing lies the floor that it stands on.
      const auto below = caster.cast(p, {0.0F, 0.0F, -1.0F}, 4.0F);
      const float light = std::max(0.0F, floor->normal.dot(Eigen::Vector3f(-0.4F, 0.4F, 0.82F).normalized()));
      const float height = (p.z() - low.z()) / (high.z() - low.z());
      const float level = 50.0F + 200.0F * light * light;
      if (below && below->distance_m > 0.05F) {
        picture.set(i, j, 110, 70, 30);
        continue;
      }
      picture.set(i, j, grey_level(level * (0.8F + 0.2F * height)), grey_level(level * 0.96F),
                  grey_level(level * (1.0F - 0.2F * height)));
    }
  }
  for (const auto& passage : world.routes.passages) {
    for (std::size_t k = 1; k < passage.path.size(); ++k) {
      const Eigen::Vector3f a = passage.path[k - 1].cast<float>(), b = passage.path[k].cast<float>();
      if (std::max(a.z(), b.z()) > ceiling) continue;
      const int steps = static_cast<int>((b - a).norm() * pixels_per_metre) + 1;
      for (int s = 0; s <= steps; ++s) {
        const Eigen::Vector3f p = a + (b - a) * (static_cast<float>(s) / static_cast<float>(steps));
        picture.set(static_cast<int>((p.x() - low.x()) * pixels_per_metre),
                    static_cast<int>((high.y() - p.y()) * pixels_per_metre), 214, 60, 40);
      }
    }
  }
  return picture;
}

/// Six upright cuts across corridors spread over the world, `half_width` metres to either side of the way.
Picture sections(const World& world, double half_width, double top) {
  constexpr int kSide = 300;
  const double scale = kSide / (2.0 * half_width);
  const int height = static_cast<int>((top + 1.5) * scale);
  Picture picture(3 * kSide, 2 * height, 255);
  std::vector<const RouteGraph::Passage*> corridors;
  for (const auto& passage : world.routes.passages) {
    if (passage.corridor && passage.length_m > 10.0) corridors.push_back(&passage);
  }
  for (int cut = 0; cut < 6; ++cut) {
    const auto& path = corridors[static_cast<std::size_t>(cut) * corridors.size() / 6]->path;
    // A little off the middle, where nothing is cut lengthwise.
    const std::size_t k = path.size() / 2;
    const Eigen::Vector3d middle = path[k - 1] + 0.43 * (path[k] - path[k - 1]);
    Eigen::Vector3d along = path[k] - path[k - 1];
    along.z() = 0.0;
    along.normalize();
    const Eigen::Vector3d side(-along.y(), along.x(), 0.0);
    for (const auto& triangle : world.mesh.triangles) {
      std::array<Eigen::Vector3d, 3> v;
      std::array<double, 3> d{};
      for (std::size_t i = 0; i < 3; ++i) {
        v[i] = world.mesh.vertices[triangle[i]].cast<double>() - middle;
        d[i] = v[i].dot(along);
      }
      if (v[0].norm() > 2.0 * (half_width + top)) continue;
      std::vector<Eigen::Vector3d> ends;
      for (std::size_t i = 0; i < 3; ++i) {
        const std::size_t j = (i + 1) % 3;
        if ((d[i] < 0.0) != (d[j] < 0.0)) ends.push_back(v[i] + (v[j] - v[i]) * (d[i] / (d[i] - d[j])));
      }
      if (ends.size() != 2) continue;
      const int steps = static_cast<int>((ends[1] - ends[0]).norm() * scale) + 1;
      for (int s = 0; s <= steps; ++s) {
        const Eigen::Vector3d p = ends[0] + (ends[1] - ends[0]) * (static_cast<double>(s) / steps);
        const int x = static_cast<int>((p.dot(side) + half_width) * scale);
        const int y = height - 1 - static_cast<int>((p.z() + 1.0) * scale);
        if (x < 0 || x >= kSide || y < 0 || y >= height) continue;
        picture.set(kSide * (cut % 3) + x, height * (cut / 3) + y, 0, 0, 0);
      }
    }
  }
  return picture;
}

void make_pictures(const std::string& folder) {
  struct View {
    WorldKind world;
    float pixels_per_metre;
    float ceiling;
    double half_width, top;
  };
  for (const View& view :
       {View{WorldKind::kTunnel, 3.5F, 100.0F, 4.0, 3.0}, View{WorldKind::kUrban, 11.0F, 4.5F, 6.0, 6.0},
        View{WorldKind::kFinals, 7.0F, 100.0F, 6.0, 5.0}, View{WorldKind::kMine, 2.5F, 100.0F, 12.0, 8.0}}) {
    SimulationOptions options;
    options.world = view.world;
    const World world = make_world(view.world, resolved(options).length_m, 1);
    const std::string path = folder + "/simulation_" + enum_name(view.world);
    plan(world, view.pixels_per_metre, view.ceiling).write(path + "_plan.ppm");
    sections(world, view.half_width, view.top).write(path + "_sections.ppm");
  }
}

// ---- registration

struct Tally {
  std::size_t pairs = 0, verified = 0, right = 0, inliers = 0;
};

/// Right within 0.5 m and 0.05 rad, an inlier within the paper's 0.05 m and 0.05 rad.
void count(Tally& tally, const RegistrationResult& result, const Eigen::Isometry3d& truth) {
  ++tally.pairs;
  if (!result.verified()) return;
  ++tally.verified;
  const Eigen::Isometry3d error = truth.inverse() * result.closure->T_from_to;
  const double metres = error.translation().norm(), radians = se3::rotation_angle(error);
  if (metres <= 0.5 && radians <= 0.05) ++tally.right;
  if (metres <= 0.05 && radians <= 0.05) ++tally.inliers;
}

void print(const std::string& what, const Tally& tally) {
  const auto percent = [&tally](std::size_t n) {
    return tally.pairs == 0 ? 0.0 : 100.0 * static_cast<double>(n) / static_cast<double>(tally.pairs);
  };
  std::printf("| %s | %zu | %.1f | %.1f | %.1f |\n", what.c_str(), tally.pairs, percent(tally.verified),
              percent(tally.right), percent(tally.inliers));
  std::fflush(stdout);
}

constexpr std::size_t kPairs = 120;  ///< Of each kind and mission.

struct Pairs {
  std::vector<std::pair<Key, Key>> of;
  void keep(Rng& rng) {
    rng.shuffle(of);
    if (of.size() > kPairs) of.resize(kPairs);
  }
};

/// Scans 1, 2 and 3 nodes apart, without a guess, as in a session without revisits.
void count_close(const Mission& mission, const ScanLoader& loader,
                 const std::map<Key, Eigen::Isometry3d>& truth, Tally& tally) {
  const FastRegistrar registrar(std::make_shared<FeatureCache>(loader));
  const auto& nodes = mission.graph.nodes();
  for (std::size_t gap = 1; gap <= 3; ++gap) {
    for (std::size_t i = gap; i < nodes.size(); ++i) {
      const Key from = nodes[i].key, to = nodes[i - gap].key;
      if (mission.robots.of(from) != mission.robots.of(to)) continue;
      count(tally, registrar.compute(pair_task(from, to, 1)), truth.at(from).inverse() * truth.at(to));
    }
  }
}

void study_registration(std::uint64_t seeds) {
  std::printf("| pairs | tried | verified %% | right %% | inliers %% |\n| --- | --- | --- | --- | --- |\n");
  for (const auto& [kind, name] : enum_names(WorldKind{})) {
    Tally raw, consecutive, revisits, parallel;
    for (std::uint64_t seed = 1; seed <= seeds; ++seed) {
      SimulationOptions options;
      options.world = kind;
      SimulationOptions raw_options = options;
      raw_options.length_m = 120.0;
      raw_options.robots = 2;
      raw_options.lidar = LidarKind::kOs1_64;
      raw_options.scans = ScanKind::kRaw;
      const SimulatedMission sweeps = simulate(raw_options, seed);
      count_close(sweeps.mission, sweeps.mission.scans->loader(), sweeps.mission.ground_truth, raw);

      const SimulatedMission made = simulate(options, seed);
      const Mission& mission = made.mission;
      const auto& nodes = mission.graph.nodes();
      Pairs next, again, aside;
      for (std::size_t i = 0; i < nodes.size(); ++i) {
        for (std::size_t j = 0; j < i; ++j) {
          const Key from = nodes[i].key, to = nodes[j].key;
          const bool same = mission.robots.of(from) == mission.robots.of(to);
          if (same && i - j == 1) next.of.emplace_back(from, to);
          if (same && i - j < 10) continue;
          const double distance =
              (mission.ground_truth.at(from).translation() - mission.ground_truth.at(to).translation())
                  .norm();
          if (distance < 2.0) again.of.emplace_back(from, to);
          // Side by side: near, in corridors, and no straight line of sight between them.
          if (distance > 8.0 && distance < 20.0 && made.in_corridor[i] && made.in_corridor[j]) {
            const Eigen::Vector3d across =
                mission.ground_truth.at(from).inverse() * mission.ground_truth.at(to).translation();
            const double turn = std::abs((mission.ground_truth.at(from).linear().col(0))
                                             .dot(mission.ground_truth.at(to).linear().col(0)));
            if (std::abs(across.y()) > 8.0 && std::abs(across.x()) < 6.0 && turn > 0.9)
              aside.of.emplace_back(from, to);
          }
        }
      }
      Rng rng(seed);
      next.keep(rng);
      again.keep(rng);
      aside.keep(rng);
      const FastRegistrar registrar(std::make_shared<FeatureCache>(mission.scans->loader()));
      ThreadPool pool;
      const auto run = [&](const Pairs& pairs, const TaskOptions& task_options, Tally& tally) {
        std::vector<RegistrationResult> results(pairs.of.size());
        pool.for_each(pairs.of.size(), [&](std::size_t p) {
          LoopCandidate candidate;
          candidate.from = pairs.of[p].first;
          candidate.to = pairs.of[p].second;
          results[p] =
              registrar.compute(make_task(mission.graph, mission.robots, candidate, task_options, seed));
        });
        for (std::size_t p = 0; p < results.size(); ++p) {
          count(tally, results[p],
                mission.ground_truth.at(pairs.of[p].first).inverse() *
                    mission.ground_truth.at(pairs.of[p].second));
        }
      };
      TaskOptions alone;
      alone.target_neighbours = 0;
      alone.use_guess = false;
      run(next, alone, consecutive);
      run(again, TaskOptions{}, revisits);
      run(aside, TaskOptions{}, parallel);
    }
    print(std::string(name) + ": OS1-64 sweeps up to 3 nodes apart, no guess", raw);
    print(std::string(name) + ": consecutive, scan to scan, no guess", consecutive);
    print(std::string(name) + ": revisits within 2 m, submap, guess", revisits);
    print(std::string(name) + ": parallel corridors, submap, guess", parallel);
  }
}

void study_session(const std::string& folder) {
  const Mission mission = read_mission(folder);
  for (const bool thinned : {true, false}) {
    const ScanLoader loader = [&](Key key) -> std::shared_ptr<const PointCloud> {
      const auto cloud = mission.scans->load(key);
      if (!cloud || !thinned) return cloud;
      return std::make_shared<const PointCloud>(simulation_detail::thin(*cloud, 1500, key));
    };
    Tally tally;
    std::map<Key, Eigen::Isometry3d> truth;
    for (const Node& node : mission.graph.nodes()) truth[node.key] = node.pose;
    count_close(mission, loader, truth, tally);
    print(thinned ? "session: up to 3 apart, thinned, no guess" : "session: up to 3 apart, raw, no guess",
          tally);
  }
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc == 3 ? argv[1] : "";
  try {
    if (what == "pictures") {
      make_pictures(argv[2]);
    } else if (what == "registration") {
      study_registration(std::strtoull(argv[2], nullptr, 10));
    } else if (what == "sessions") {
      study_session(argv[2]);
    } else {
      std::cerr
          << "usage: loopwise_simulation_study pictures FOLDER | registration SEEDS | sessions FOLDER\n";
      return 2;
    }
  } catch (const std::exception& error) {
    std::cerr << "loopwise_simulation_study: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
