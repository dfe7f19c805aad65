// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <optional>
#include <utility>

#include <loopwise/features/place.hpp>

#include "../core/constants.hpp"
#include "density_image.hpp"
#include "place_store.hpp"

namespace loopwise {
namespace {

/// Starts to load a cache line that is needed soon.
inline void prefetch(const void* at) {
#if defined(__GNUC__)
  __builtin_prefetch(at);
#else
  static_cast<void>(at);
#endif
}

float wrapped(float angle) {
  return angle - 2.0F * kPiFloat * std::round(angle / (2.0F * kPiFloat));
}

/// A pose of one level frame in another, seen from above.
struct Pose2 {
  float yaw = 0.0F, c = 1.0F, s = 0.0F;
  Eigen::Vector2f t = Eigen::Vector2f::Zero();

  Pose2() = default;
  Pose2(float angle, const Eigen::Vector2f& translation)
      : yaw(angle), c(std::cos(angle)), s(std::sin(angle)), t(translation) {}
  [[nodiscard]] Eigen::Vector2f turned(const Eigen::Vector2f& p) const {
    return {c * p.x() - s * p.y(), s * p.x() + c * p.y()};
  }
  Eigen::Vector2f operator*(const Eigen::Vector2f& p) const { return turned(p) + t; }
  [[nodiscard]] Pose2 inverse() const {
    Pose2 out(-yaw, Eigen::Vector2f::Zero());
    out.t = -out.turned(t);
    return out;
  }
};

struct DensityPlace final : PlaceDescriptor {
  std::vector<PlaceFeature> features;
  float ground_m = 0.0F;
  float cell_m = 0.5F;
  int size = 0;
  std::vector<std::uint64_t> seen;       // one bit per column: whether it holds points
  std::vector<std::uint64_t> near_tall;  // columns that are tall or next to a tall one
  std::vector<Eigen::Vector2f> tall;     // middles of at most kTallColumns tall columns
  float chance = 0.0F;                   // share of the seen columns that are near tall ones

  [[nodiscard]] std::size_t bytes() const override {
    return sizeof(*this) + features.capacity() * sizeof(features[0]) +
           (seen.capacity() + near_tall.capacity()) * sizeof(seen[0]) + tall.capacity() * sizeof(tall[0]);
  }
  [[nodiscard]] static bool bit(const std::vector<std::uint64_t>& bits, int at) {
    return ((bits[static_cast<std::size_t>(at) / 64] >> (static_cast<std::size_t>(at) % 64)) & 1U) != 0;
  }
};

constexpr std::uint8_t kTall = 3;          // voxels of a tall column
constexpr std::size_t kTallColumns = 600;  // kept per place

void fill_bits(DensityPlace& place, const DensityImage& image) {
  const auto count = image.heights.size();
  place.cell_m = image.cell_m;
  place.size = image.size;
  place.ground_m = image.ground_m;
  place.seen.assign((count + 63) / 64, 0);
  place.near_tall = place.seen;
  const auto set = [](std::vector<std::uint64_t>& bits, std::size_t at) {
    bits[at / 64] |= std::uint64_t{1} << (at % 64);
  };
  std::vector<Eigen::Vector2f> all;
  for (int y = 0; y < image.size; ++y) {
    for (int x = 0; x < image.size; ++x) {
      const std::size_t at =
          static_cast<std::size_t>(y) * static_cast<std::size_t>(image.size) + static_cast<std::size_t>(x);
      if (image.heights[at] == 0) continue;
      set(place.seen, at);
      if (image.heights[at] < kTall) continue;
      all.emplace_back(image.middle(static_cast<float>(x)), image.middle(static_cast<float>(y)));
      for (int v = std::max(0, y - 1); v <= std::min(image.size - 1, y + 1); ++v) {
        for (int u = std::max(0, x - 1); u <= std::min(image.size - 1, x + 1); ++u)
          set(place.near_tall, static_cast<std::size_t>(v) * static_cast<std::size_t>(image.size) +
                                   static_cast<std::size_t>(u));
      }
    }
  }
  const std::size_t kept = std::min(all.size(), kTallColumns);
  for (std::size_t i = 0; i < kept; ++i) place.tall.push_back(all[i * all.size() / kept]);
  std::size_t seen = 0, near = 0;
  for (int at = 0; at < static_cast<int>(count); ++at) {
    if (!DensityPlace::bit(place.seen, at)) continue;
    ++seen;
    if (DensityPlace::bit(place.near_tall, at)) ++near;
  }
  place.chance = seen > 0 ? static_cast<float>(near) / static_cast<float>(seen) : 1.0F;
}

/// Similarity of two places at a pose. Counts the tall columns of `from` that meet a seen column of `to`: the
/// share of them that meets a tall column or its neighbour, above the share expected by chance. The factor
/// for the share of columns in common prefers near places.
double agreement(const DensityPlace& from, const DensityPlace& to, const Pose2& T_to_from) {
  std::size_t common = 0, hits = 0;
  const float half = 0.5F * static_cast<float>(to.size);
  for (const Eigen::Vector2f& middle : from.tall) {
    const Eigen::Vector2f p = (T_to_from * middle) / to.cell_m + Eigen::Vector2f(half, half);
    if (!(p.minCoeff() >= 0.0F) || !(p.maxCoeff() < static_cast<float>(to.size))) continue;
    const int at = static_cast<int>(p.y()) * to.size + static_cast<int>(p.x());
    if (!DensityPlace::bit(to.seen, at)) continue;
    ++common;
    if (DensityPlace::bit(to.near_tall, at)) ++hits;
  }
  constexpr double kFew = 50.0;
  const double share = static_cast<double>(hits) / (static_cast<double>(common) + kFew);
  const double chance = std::min(0.9, static_cast<double>(to.chance));
  const double seen =
      static_cast<double>(common) / std::max<double>(1.0, static_cast<double>(from.tall.size()));
  return std::sqrt(seen) * std::clamp((share - chance) / (1.0 - chance), 0.0, 1.0);
}

/// A pair of similar features: of the query and of a place. Packed, because thousands are sorted in each
/// search: by place, then by the features' numbers, of which a place has at most 1000.
class Hit {
 public:
  static constexpr std::uint64_t kYaws = 18;  ///< Steps of the yaw from the match to the query.

  Hit(std::uint64_t place, std::uint64_t query, std::uint64_t match, std::uint64_t yaw)
      : packed_(place << 32 | query << 20 | match << 8 | yaw) {}
  [[nodiscard]] std::size_t place() const { return packed_ >> 32; }
  [[nodiscard]] std::size_t query() const { return packed_ >> 20 & 0xfffU; }  ///< Number of the feature.
  [[nodiscard]] std::size_t match() const { return packed_ >> 8 & 0xfffU; }   ///< Number of the feature.
  [[nodiscard]] std::size_t yaw() const { return packed_ & 0xffU; }           ///< Step of kYaws.
  bool operator<(const Hit& other) const { return packed_ < other.packed_; }
  bool operator==(const Hit& other) const { return packed_ == other.packed_; }

 private:
  std::uint64_t packed_;
};

/// The largest number of hits that agree on a yaw.
int turned_alike(const Hit* hits, std::size_t count) {
  std::array<int, Hit::kYaws> votes{};
  for (std::size_t i = 0; i < count; ++i) ++votes[hits[i].yaw()];
  int most = 0;
  for (std::size_t i = 0; i < Hit::kYaws; ++i) most = std::max(most, votes[i] + votes[(i + 1) % Hit::kYaws]);
  return most;
}

struct Hypothesis {
  std::size_t place = 0;
  int support = 0;
  Pose2 T_query_match;
};

constexpr float kNear_m = 2.0F, kTurned_rad = 0.35F;  // tolerances for two features of one object

/// The pose that most hits of a place support. Each hit gives a pose of its own.
Hypothesis consensus(const DensityPlace& query, const DensityPlace& match, const Hit* hits,
                     std::size_t count) {
  constexpr std::size_t kMost = 80;
  const std::size_t step = (count + kMost - 1) / kMost;
  Hypothesis best;
  best.place = hits->place();
  for (std::size_t i = 0; i < count; i += step) {
    const PlaceFeature& a = query.features[hits[i].query()];
    const PlaceFeature& b = match.features[hits[i].match()];
    Pose2 T(wrapped(a.angle - b.angle), Eigen::Vector2f::Zero());
    T.t = a.position - T.turned(b.position);
    int support = 0;
    for (std::size_t j = 0; j < count; j += step) {
      const PlaceFeature& c = query.features[hits[j].query()];
      const PlaceFeature& d = match.features[hits[j].match()];
      if (std::abs(wrapped(c.angle - d.angle - T.yaw)) < kTurned_rad &&
          (T * d.position - c.position).squaredNorm() < 2.0F * kNear_m * kNear_m)
        ++support;
    }
    if (support > best.support) {
      best.support = support;
      best.T_query_match = T;
    }
  }
  return best;
}

/// The features of a place in square cells, so that those near a point are found without a look at all.
class FeatureGrid {
 public:
  FeatureGrid(const std::vector<PlaceFeature>& features, float reach_m)
      : reach_m_(reach_m),
        cell_m_(std::max(kNearest_m, reach_m / 32.0F)),
        cells_(2 * static_cast<int>(std::ceil(reach_m / cell_m_)) + 1),
        begin_(static_cast<std::size_t>(cells_) * static_cast<std::size_t>(cells_) + 1, 0) {
    for (const PlaceFeature& feature : features) ++begin_[cell_of(feature) + 1];
    for (std::size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
    numbers_.resize(features.size());
    std::vector<std::uint16_t> next(begin_.begin(), begin_.end() - 1);
    for (std::size_t i = 0; i < features.size(); ++i)
      numbers_[next[cell_of(features[i])]++] = static_cast<std::uint16_t>(i);
  }

  /// Calls visit(number of a feature) for all features within kNearest_m of a point, and for some beyond.
  template <class Visit>
  void near(const Eigen::Vector2f& point, const Visit& visit) const {
    if (!(point.cwiseAbs().maxCoeff() < reach_m_ + cell_m_)) return;
    const int x = column(point.x()), y = column(point.y());
    for (int v = std::max(0, y - 1); v <= std::min(cells_ - 1, y + 1); ++v) {
      const int row = v * cells_;
      const auto first = static_cast<std::size_t>(row + std::max(0, x - 1));
      const auto last = static_cast<std::size_t>(row + std::min(cells_ - 1, x + 1));
      for (std::size_t i = begin_[first]; i < begin_[last + 1]; ++i) visit(numbers_[i]);
    }
  }

  static constexpr float kNearest_m = 1.5F * kNear_m;

 private:
  [[nodiscard]] int column(float coordinate_m) const {
    return static_cast<int>(std::floor((coordinate_m + reach_m_) / cell_m_));
  }
  [[nodiscard]] std::size_t cell_of(const PlaceFeature& feature) const {
    const int x = std::clamp(column(feature.position.x()), 0, cells_ - 1),
              y = std::clamp(column(feature.position.y()), 0, cells_ - 1);
    return static_cast<std::size_t>(y * cells_ + x);
  }

  float reach_m_;  // half the width of the image
  float cell_m_;
  int cells_;  // along each axis
  std::vector<std::uint16_t> begin_, numbers_;
};

/// A pose that was refined with all matching features of the two places.
struct Refined {
  Pose2 T_query_match;
  int inliers = 0;
  float rms_m = 0.0F;
};

/// \param near_m at most FeatureGrid::kNearest_m
Refined refine(const DensityPlace& query, const FeatureGrid& grid, const DensityPlace& match, Refined from,
               int most_bits, float near_m) {
  Eigen::Vector2f mean_q = Eigen::Vector2f::Zero(), mean_m = mean_q;
  std::vector<std::pair<Eigen::Vector2f, Eigen::Vector2f>> pairs;
  const Pose2& T = from.T_query_match;
  for (const PlaceFeature& b : match.features) {
    const Eigen::Vector2f moved = T * b.position;
    const PlaceFeature* best = nullptr;
    int least = most_bits + 1;
    grid.near(moved, [&](std::size_t number) {
      const PlaceFeature& a = query.features[number];
      if ((a.position - moved).squaredNorm() > near_m * near_m ||
          std::abs(wrapped(a.angle - b.angle - T.yaw)) > kTurned_rad)
        return;
      const int bits = differing_bits(a.bits, b.bits);
      const bool better = bits < least || (bits == least && best != nullptr && &a < best);
      if (!better) return;
      least = bits;
      best = &a;
    });
    if (best == nullptr) continue;
    pairs.emplace_back(best->position, b.position);
    mean_q += best->position;
    mean_m += b.position;
  }
  from.inliers = static_cast<int>(pairs.size());
  if (pairs.size() < 2) return from;
  mean_q /= static_cast<float>(pairs.size());
  mean_m /= static_cast<float>(pairs.size());
  float dot = 0.0F, cross = 0.0F;
  for (const auto& [q, m] : pairs) {
    const Eigen::Vector2f a = q - mean_q, b = m - mean_m;
    dot += a.dot(b);
    cross += b.x() * a.y() - b.y() * a.x();
  }
  from.T_query_match = Pose2(std::atan2(cross, dot), Eigen::Vector2f::Zero());
  from.T_query_match.t = mean_q - from.T_query_match.turned(mean_m);
  float squares = 0.0F;
  for (const auto& [q, m] : pairs) squares += (from.T_query_match * m - q).squaredNorm();
  from.rms_m = std::sqrt(squares / static_cast<float>(pairs.size()));
  return from;
}

class DensityPlaceDatabase final : public PlaceDatabase {
 public:
  explicit DensityPlaceDatabase(const DensityPlaceOptions& options) : options_(options) {
    validate(options_);
    if (options_.range_m > 500.0 * options_.cell_m) {
      throw OptionError("range_m = " + std::to_string(options_.range_m) +
                        ", must be <= 500 cell_m = " + std::to_string(500.0 * options_.cell_m));
    }
    for (auto& table : tables_) table.resize(std::size_t{1} << kHashBits);
  }

  [[nodiscard]] std::string_view name() const override { return "density"; }
  [[nodiscard]] std::size_t size() const override { return places_.size(); }
  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> find(Key key) const override {
    return places_.find(key);
  }

  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> describe(const PointCloud& level) const override {
    auto place = std::make_shared<DensityPlace>();
    const DensityImage image = density_image(level, options_.cell_m, options_.range_m);
    fill_bits(*place, image);
    place->features = place_features(image, static_cast<std::size_t>(options_.key_points));
    return place;
  }

  void insert(Key key, std::shared_ptr<const PlaceDescriptor> place) override {
    const std::size_t number = places_.add(key, std::move(place), name());
    const std::vector<PlaceFeature>& features = places_[number].features;
    for (std::size_t i = 0; i < features.size(); ++i) {
      const auto id = static_cast<std::uint32_t>(index_.size());
      for (std::size_t t = 0; t < kTables; ++t) tables_[t][hash(features[i], t)].push_back(id);
      index_.push_back({features[i].bits, features[i].angle, static_cast<std::uint32_t>(number),
                        static_cast<std::uint32_t>(i)});
    }
  }

  [[nodiscard]] std::vector<PlaceMatch> search(const PlaceDescriptor& place, std::size_t k,
                                               const PlaceFilter& filter) const override {
    const DensityPlace& query = places_.own(place, name());
    const FeatureGrid grid(query.features, 0.5F * static_cast<float>(query.size) * query.cell_m);
    std::vector<PlaceMatch> matches;
    for (const Hypothesis& hypothesis : hypotheses(query, std::max(k, compared()), filter)) {
      if (auto match = accepted_match(query, grid, hypothesis)) matches.push_back(*match);
    }
    keep_best(matches, k);
    return matches;
  }

 private:
  static constexpr std::size_t kTables = 10, kHashBits = 16;
  static constexpr std::size_t kCommon = 200;  // features; larger buckets are skipped as too common

  [[nodiscard]] static std::size_t hash(const PlaceFeature& feature, std::size_t table) {
    return (feature.bits.words[table / 4] >> (16 * (table % 4))) & 0xffffU;
  }
  [[nodiscard]] std::size_t compared() const { return static_cast<std::size_t>(options_.compared); }

  using Bucket = std::vector<std::uint32_t>;
  [[nodiscard]] const Bucket& bucket(const PlaceFeature& feature, std::size_t table) const {
    return tables_[table][hash(feature, table)];
  }

  /// Starts to load the buckets of the feature after next, and the contents of those of the next one.
  void prefetch_buckets(const std::vector<PlaceFeature>& features, std::size_t at) const {
    for (std::size_t t = 0; t < kTables; ++t) {
      if (at + 2 < features.size()) prefetch(&bucket(features[at + 2], t));
      if (at + 1 < features.size()) prefetch(bucket(features[at + 1], t).data());
    }
  }

  /// Pairs of similar features by place.
  [[nodiscard]] std::vector<Hit> hits(const DensityPlace& query) const {
    std::vector<Hit> found;
    std::vector<std::uint32_t> ids;  // of features that share a group of bits with the one of the query
    for (std::size_t q = 0; q < query.features.size(); ++q) {
      const PlaceFeature& feature = query.features[q];
      // The index is spread over memory, and a search spends most of its time waiting for it.
      prefetch_buckets(query.features, q);
      ids.clear();
      for (std::size_t t = 0; t < kTables; ++t) {
        const Bucket& similar = bucket(feature, t);
        if (similar.size() > kCommon) continue;
        for (const std::uint32_t id : similar) prefetch(&index_[id]);
        ids.insert(ids.end(), similar.begin(), similar.end());
      }
      keep_similar(feature.bits, index_, options_.match_bits, ids);
      for (const std::uint32_t id : ids) {
        const IndexedFeature& match = index_[id];
        const float turn = (feature.angle - match.angle) / (2.0F * kPiFloat);
        const int yaw =
            static_cast<int>((turn - std::floor(turn)) * Hit::kYaws) % static_cast<int>(Hit::kYaws);
        found.emplace_back(match.place, q, match.number, static_cast<std::uint64_t>(yaw));
      }
    }
    std::sort(found.begin(), found.end());
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found;
  }

  /// The places whose hits agree best on a pose.
  [[nodiscard]] std::vector<Hypothesis> hypotheses(const DensityPlace& query, std::size_t most,
                                                   const PlaceFilter& filter) const {
    const std::vector<Hit> all = hits(query);
    struct Group {
      std::size_t begin, count;
      int turned_alike;
    };
    std::vector<Group> groups;
    for (std::size_t begin = 0, end = 0; begin < all.size(); begin = end) {
      while (end < all.size() && all[end].place() == all[begin].place()) ++end;
      groups.push_back({begin, end - begin, turned_alike(&all[begin], end - begin)});
    }
    const auto worse = [](const Group& a, const Group& b) {
      return a.turned_alike != b.turned_alike ? a.turned_alike < b.turned_alike : a.begin > b.begin;
    };
    // Takes the best groups one by one, so that the filter sees few places.
    std::make_heap(groups.begin(), groups.end(), worse);
    std::vector<Hypothesis> out;
    for (auto end = groups.end(); end != groups.begin() && out.size() < 4 * most; --end) {
      std::pop_heap(groups.begin(), end, worse);
      const Group& group = *std::prev(end);
      const Hit* first = &all[group.begin];
      if (filter && !filter(places_.key(first->place()))) continue;
      out.push_back(consensus(query, places_[first->place()], first, group.count));
    }
    std::sort(out.begin(), out.end(), [](const Hypothesis& a, const Hypothesis& b) {
      return a.support != b.support ? a.support > b.support : a.place < b.place;
    });
    if (out.size() > most) out.resize(most);
    return out;
  }

  [[nodiscard]] std::optional<PlaceMatch> accepted_match(const DensityPlace& query, const FeatureGrid& grid,
                                                         const Hypothesis& hypothesis) const {
    const DensityPlace& other = places_[hypothesis.place];
    Refined pose{hypothesis.T_query_match, hypothesis.support, kNear_m};
    for (const float near_m : {1.5F * kNear_m, kNear_m})
      pose = refine(query, grid, other, pose, options_.match_bits + 20, near_m);
    if (pose.inliers < 2) return std::nullopt;
    const double agreed = std::min(agreement(other, query, pose.T_query_match),
                                   agreement(query, other, pose.T_query_match.inverse()));
    constexpr double kManyInliers = 6.0;
    PlaceMatch match;
    match.key = places_.key(hypothesis.place);
    match.similarity = agreed * (1.0 - std::exp(-static_cast<double>(pose.inliers) / kManyInliers));
    if (!(match.similarity > 0.0)) return std::nullopt;
    match.T_query_match.linear() = se3::so3_exp({0.0, 0.0, static_cast<double>(pose.T_query_match.yaw)});
    match.T_query_match.translation() << pose.T_query_match.t.cast<double>(),
        static_cast<double>(query.ground_m) - static_cast<double>(other.ground_m);
    constexpr double kYawSigma_rad = 0.05;
    match.covariance = level_covariance(2.0 * options_.cell_m, kHeightSigma_m, kTiltSigma_rad, kYawSigma_rad);
    return match;
  }

  DensityPlaceOptions options_;
  PlaceStore<DensityPlace> places_;
  std::array<std::vector<Bucket>, kTables> tables_;  // features by the value of some of their bits
  std::vector<IndexedFeature> index_;                // the features of all places
};

}  // namespace

std::unique_ptr<PlaceDatabase> make_density_place_database(const DensityPlaceOptions& options) {
  return std::make_unique<DensityPlaceDatabase>(options);
}

}  // namespace loopwise
