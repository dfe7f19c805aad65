// SPDX-License-Identifier: BSD-3-Clause
// own_places MISSION: a place recognition of your own in the live module.
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>

#include <loopwise/features/place.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/online/loop_closure_module.hpp>

using namespace loopwise;

/// Distances of points: shares of rings of 2 m.
struct Rings final : PlaceDescriptor {
  std::array<double, 20> share{};
  [[nodiscard]] std::size_t bytes() const override { return sizeof(*this); }
};

class RingDatabase final : public PlaceDatabase {
 public:
  [[nodiscard]] std::string_view name() const override { return "rings"; }

  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> describe(const PointCloud& level) const override {
    auto rings = std::make_shared<Rings>();
    for (const Eigen::Vector3f& p : level.points) {
      const auto ring = static_cast<std::size_t>(p.head<2>().norm() / 2.0F);
      rings->share[std::min(ring, rings->share.size() - 1)] += 1.0 / static_cast<double>(level.size());
    }
    return rings;
  }
  void insert(Key key, std::shared_ptr<const PlaceDescriptor> place) override {
    places_[key] = std::move(place);
  }

  [[nodiscard]] std::vector<PlaceMatch> search(const PlaceDescriptor& place, std::size_t k,
                                               const PlaceFilter& filter) const override {
    std::vector<PlaceMatch> matches;
    for (const auto& [key, other] : places_) {
      if (filter && !filter(key)) continue;
      double common = 0.0;
      for (std::size_t i = 0; i < Rings().share.size(); ++i)
        common += std::min(shares(place)[i], shares(*other)[i]);
      PlaceMatch match;  // T_query_match: the identity, with sigmas of 5 m and 1 rad
      match.key = key;
      match.similarity = common;
      match.covariance.diagonal() << 25.0, 25.0, 1.0, 0.01, 0.01, 1.0;
      matches.push_back(match);
    }
    std::stable_sort(matches.begin(), matches.end(),
                     [](const PlaceMatch& a, const PlaceMatch& b) { return a.similarity > b.similarity; });
    if (matches.size() > k) matches.resize(k);
    return matches;
  }
  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> find(Key key) const override {
    const auto found = places_.find(key);
    return found == places_.end() ? nullptr : found->second;
  }
  [[nodiscard]] std::size_t size() const override { return places_.size(); }

 private:
  static const std::array<double, 20>& shares(const PlaceDescriptor& place) {
    return dynamic_cast<const Rings&>(place).share;
  }
  std::map<Key, std::shared_ptr<const PlaceDescriptor>> places_;
};

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const Mission mission = read_mission(argv[1]);
  ModuleParts parts;
  parts.places = std::make_unique<RingDatabase>();
  std::atomic<int> computed{0}, closures{0};
  ModuleCallbacks callbacks;
  callbacks.on_result = [&](const RegistrationResult& result) {
    ++computed;
    if (result.verified()) ++closures;
  };
  ModuleOptions options;
  options.engine.use_proximity = false;  // candidates by appearance alone
  options.appearance.per_place = 1;
  LoopClosureModule module(mission.robots, options, callbacks, std::move(parts));
  for (std::uint64_t i = 0; i < 10; ++i) {
    for (const Robot& robot : mission.robots.all()) {
      KeyFrame frame;
      frame.node = mission.graph.node(robot.first + i);
      frame.cloud = mission.scans->load(frame.node.key);
      if (!module.add_key_frame(frame)) return 1;
    }
  }
  if (!module.wait()) return 1;
  std::printf("%d candidates, %d closures\n", computed.load(), closures.load());
  return computed > 0 ? 0 : 1;
}
