// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <loopwise/features/place.hpp>

#include "../core/constants.hpp"
#include "density_image.hpp"
#include "place_store.hpp"

namespace loopwise {
namespace {

struct ScanContext final : PlaceDescriptor {
  Eigen::MatrixXf columns;  // a column per sector, of unit length or zero
  Eigen::VectorXf rings;    // mean of each ring
  int filled = 0;           // columns that are not zero
  float ground_m = 0.0F;    // in the level frame

  [[nodiscard]] std::size_t bytes() const override {
    return sizeof(*this) + static_cast<std::size_t>(columns.size() + rings.size()) * sizeof(float);
  }
};

/// Similarity of two places at the best shift of columns, and that shift.
struct Comparison {
  double similarity = 0.0;
  int shift = 0;  // sector s of one place is sector s + shift of the other
};

Comparison compare(const ScanContext& a, const ScanContext& b) {
  const auto sectors = static_cast<int>(a.columns.cols());
  const Eigen::MatrixXf cosines = a.columns.transpose() * b.columns;
  const int filled = std::max(a.filled, b.filled);
  Comparison best;
  for (int shift = 0; shift < sectors && filled > 0; ++shift) {
    double sum = 0.0;
    for (int s = 0; s < sectors; ++s) sum += static_cast<double>(cosines(s, (s + shift) % sectors));
    const double similarity = std::clamp(sum / filled, 0.0, 1.0);
    if (similarity > best.similarity) best = {similarity, shift};
  }
  return best;
}

class ScanContextDatabase final : public PlaceDatabase {
 public:
  explicit ScanContextDatabase(const ScanContextOptions& options) : options_(options) { validate(options_); }

  [[nodiscard]] std::string_view name() const override { return "scan_context"; }
  [[nodiscard]] std::size_t size() const override { return places_.size(); }
  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> find(Key key) const override {
    return places_.find(key);
  }
  void insert(Key key, std::shared_ptr<const PlaceDescriptor> place) override {
    places_.add(key, std::move(place), name());
  }

  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> describe(const PointCloud& level) const override {
    auto place = std::make_shared<ScanContext>();
    place->ground_m = ground_height(level.points);
    Eigen::MatrixXf heights = Eigen::MatrixXf::Zero(options_.rings, options_.sectors);
    for (const Eigen::Vector3f& p : level.points) {
      const double range = std::hypot(static_cast<double>(p.x()), static_cast<double>(p.y()));
      if (!(range < options_.range_m)) continue;
      const double turn = std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x())) / (2.0 * kPi);
      const int ring = static_cast<int>(range / options_.range_m * options_.rings);
      const int sector = static_cast<int>((turn + 1.0) * options_.sectors) % options_.sectors;
      float& height = heights(std::min(ring, options_.rings - 1), sector);
      height = std::max(height, p.z() - place->ground_m);
    }
    place->rings = heights.rowwise().mean();
    for (Eigen::Index s = 0; s < heights.cols(); ++s) {
      const float norm = heights.col(s).norm();
      if (!(norm > 0.0F)) continue;
      heights.col(s) /= norm;
      ++place->filled;
    }
    place->columns = std::move(heights);
    return place;
  }

  [[nodiscard]] std::vector<PlaceMatch> search(const PlaceDescriptor& place, std::size_t k,
                                               const PlaceFilter& filter) const override {
    const ScanContext& query = places_.own(place, name());
    std::vector<std::pair<float, std::size_t>> near;
    for (std::size_t i = 0; i < places_.size(); ++i) {
      if (filter && !filter(places_.key(i))) continue;
      near.emplace_back((places_[i].rings - query.rings).squaredNorm(), i);
    }
    const std::size_t compared =
        std::min(near.size(), std::max(k, static_cast<std::size_t>(options_.compared)));
    std::partial_sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(compared), near.end());
    near.resize(compared);
    std::vector<PlaceMatch> matches;
    for (const auto& [distance, i] : near) {
      const Comparison found = compare(query, places_[i]);
      if (!(found.similarity > 0.0)) continue;
      PlaceMatch match;
      match.key = places_.key(i);
      match.similarity = found.similarity;
      // Bearing b in the query is bearing b + shift in the match.
      const double sector = 2.0 * kPi / options_.sectors;
      match.T_query_match.linear() = se3::so3_exp({0.0, 0.0, -sector * found.shift});
      match.T_query_match.translation().z() =
          static_cast<double>(query.ground_m) - static_cast<double>(places_[i].ground_m);
      match.covariance = level_covariance(options_.sigma_m, kHeightSigma_m, kTiltSigma_rad, sector);
      matches.push_back(match);
    }
    keep_best(matches, k);
    return matches;
  }

 private:
  ScanContextOptions options_;
  PlaceStore<ScanContext> places_;
};

}  // namespace

std::unique_ptr<PlaceDatabase> make_scan_context_database(const ScanContextOptions& options) {
  return std::make_unique<ScanContextDatabase>(options);
}

}  // namespace loopwise
