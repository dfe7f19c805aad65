// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string_view>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/closure_tests.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Registration `fast`: descriptors, consensus, refinement, tests.
struct FastRegistrarOptions {
  /// Radius of the FPFH descriptors, m.
  double fpfh_radius_m = 2.5;
  /// Maximum number of neighbours within the radius, evenly sampled, that form a histogram.
  int fpfh_neighbours = 40;
  /// Maximum number of key points per scan. They are drawn evenly from all directions of surfaces.
  int key_points = 1000;
  /// Maximum share of the points of a scan that become key points, since sparse scans need fewer. 200 key
  /// points are always allowed.
  double key_share = 0.4;
  /// Maximum number of matches of key points in which consensus is searched.
  int max_matches = 1000;
  /// Two matches agree if the distances between their key points in the two scans differ by less than this,
  /// m.
  double match_tolerance_m = 0.6;
  /// Number of poses from consensus that are compared on the scans.
  int hypotheses = 40;
  /// Number of source points with which hypotheses are compared.
  int score_points = 300;
  /// The pair is rejected if a smaller share of score_points lies on the target. Points closer to the target
  /// count more.
  double min_score = 0.15;
  /// Number of best hypotheses of descriptors, and of poses with the most votes, that are refined and
  /// compared in detail.
  int refined_hypotheses = 3;
  /// If none of those with the most votes passes the tests, up to this many other voted poses are refined,
  /// near the guess and then in the rest of its region.
  int refined_votes = 6;
  /// The refined guess is tested before other poses are searched if at least this share of score_points lies
  /// on surfaces of the target, relative to the same share within the scans themselves.
  double sure_share = 0.5;
  /// A pair is rejected as ambiguous if the fit of a second pose is lower by at most this. The second pose is
  /// more than 1 m or 5 degrees away and outside the covariance of the closure. The fit is min(1,
  /// consistency) + ln(share of points on surfaces) / 10.
  double ambiguous_margin = 0.15;
  /// A smaller overlap than min_overlap, down to this one, suffices if surfaces fix all directions of the
  /// translation to 0.5 m. Not used if min_overlap is above 0.4, its default: every closure must then overlap
  /// as much.
  double min_certain_overlap = 0.15;
  /// The source is shifted by 1 m along each axis. If this share of the points that constrain the axis still
  /// lies on surfaces, the standard deviation along the axis is half of max_sigma_m. Smaller shares give
  /// smaller values, smoothly.
  double free_share = 0.5;
  /// Poses are searched where the guess differs by at most this many standard deviations, if its covariance
  /// is known. Within half of max_translation_m and 2.5 m of height they are always searched. 0: everywhere
  /// within max_translation_m.
  double guess_sigmas = 5.0;
  /// Maximum distance of matched points in the first pass, m.
  double coarse_reach_m = 2.0;
  /// Maximum distance of matched points in the last pass, m.
  double fine_reach_m = 0.5;
  /// Number of source points in the first passes.
  int coarse_points = 300;
  /// Number of source points in the last pass.
  int fine_points = 2000;
  /// Memory for submaps, MB. The descriptors of submaps and those of scans get as much each.
  double max_descriptor_mb = 256.0;
  /// Bounds of the tests. In files and on the command line they are fields of fast_registrar.
  ClosureTestOptions tests = default_tests();

  /// These bounds differ from those of PclRegistrar. Consistency is decisive here, so scans may extend
  /// further beyond each other.
  [[nodiscard]] static ClosureTestOptions default_tests() {
    ClosureTestOptions tests;
    tests.max_fitness_m2 = 2.2;
    tests.measured_points = 2000;
    tests.full_overlap = 0.5;
    tests.min_consistency = 0.85;
    return tests;
  }

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("fpfh_radius_m", self.fpfh_radius_m, above(0.0));
    field("fpfh_neighbours", self.fpfh_neighbours, between(3.0, 1000.0));
    field("key_points", self.key_points, between(3.0, 10000.0));
    field("key_share", self.key_share, between(0.0, 1.0));
    field("max_matches", self.max_matches, between(3.0, 10000.0));
    field("match_tolerance_m", self.match_tolerance_m, above(0.0));
    field("hypotheses", self.hypotheses, between(1.0, 1000.0));
    field("score_points", self.score_points, between(3.0, 100000.0));
    field("min_score", self.min_score, between(0.0, 1.0));
    field("refined_hypotheses", self.refined_hypotheses, between(1.0, 100.0));
    field("refined_votes", self.refined_votes, between(1.0, 100.0));
    field("sure_share", self.sure_share, between(0.0, 1.0));
    field("ambiguous_margin", self.ambiguous_margin, at_least(0.0));
    field("min_certain_overlap", self.min_certain_overlap, between(0.0, 1.0));
    field("free_share", self.free_share, between(0.01, 0.99));
    field("guess_sigmas", self.guess_sigmas, at_least(0.0));
    field("coarse_reach_m", self.coarse_reach_m, above(0.0));
    field("fine_reach_m", self.fine_reach_m, above(0.0));
    field("coarse_points", self.coarse_points, at_least(10.0));
    field("fine_points", self.fine_points, at_least(10.0));
    field("max_descriptor_mb", self.max_descriptor_mb, at_least(0.0));
    visit_part(self.tests, field);
  }
};

/// Registration at less than a tenth of the cost of the reference, without random draws. It first tries the
/// graph's guess, then translations for which pairs of parallel surfaces vote, first near the guess and then
/// as far as its covariance says (guess_sigmas). Without a guess or its covariance, or within bounds of more
/// than 24 m, it uses mutual FPFH matches, consensus by second-order compatibility, and a comparison of the
/// hypotheses on the scans; without a guess, votes come last. The best poses are refined by generalized ICP
/// (Gauss-Newton, from coarse to fine) and compared in detail. A pose that passes the tests is compared with
/// rivals from symmetries and periods of the place; the pair is ambiguous if one fits as well. Pairs without
/// overlap are rejected early. Thread-safe; data of a scan or a submap are computed once.
class LOOPWISE_EXPORT FastRegistrar final : public Registrar {
 public:
  /// \throws OptionError; InputError if `features` is null.
  explicit FastRegistrar(std::shared_ptr<FeatureCache> features, const FastRegistrarOptions& options = {});
  ~FastRegistrar() override;

  [[nodiscard]] std::string_view name() const override { return "fast"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override;
  /// Computes the data of a scan now; compute() otherwise does it on first use. Does nothing without a scan.
  void prepare(Key key) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
