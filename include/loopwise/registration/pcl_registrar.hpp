// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/closure_tests.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// The tests of `pcl`: its covariances are larger than those of `fast`, because more of its errors are large.
[[nodiscard]] inline ClosureTestOptions pcl_tests() {
  ClosureTestOptions tests;
  tests.points_per_sample = 10.0;
  tests.min_sigma_m = 0.01;
  tests.min_sigma_rad = 0.003;
  return tests;
}

/// Registration `pcl`: descriptors, SAC-IA, GICP, tests.
struct PclRegistrarOptions {
  /// Radius of the FPFH descriptors, m.
  double fpfh_radius_m = 2.0;
  /// Number of key points per scan, drawn evenly from all directions of surfaces. 0: all points with a
  /// normal.
  int key_points = 1000;
  /// Number of hypotheses of the feature-based stage.
  int sac_hypotheses = 500;
  /// A match is drawn from this many nearest descriptors of the target.
  int sac_randomness = 5;
  /// Larger distances of key points count as this distance when hypotheses are compared, m.
  double sac_truncation_m = 2.0;
  /// The candidate is refused if the mean squared distance of the key points of the best hypothesis is
  /// larger, m².
  double max_sac_fitness_m2 = 32.0;
  /// Maximum distance of matched points, m. GICP runs once for each value, in order.
  std::vector<double> max_correspondence_m = {2.0, 0.5};
  /// Maximum number of iterations of each run of GICP.
  int gicp_iterations = 200;
  /// A run of GICP ends when no translation changes by more than this, m, and gicp_rotation_epsilon is met
  /// too.
  double gicp_translation_epsilon_m = 5e-4;
  /// A run of GICP ends when no element of the rotation matrix changes by more than this, and
  /// gicp_translation_epsilon_m is met too.
  double gicp_rotation_epsilon = 5e-4;
  /// Memory for descriptors, MB.
  double max_descriptor_mb = 256.0;
  ClosureTestOptions tests = pcl_tests();  ///< Fields of the same section.

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("fpfh_radius_m", self.fpfh_radius_m, above(0.0));
    field("key_points", self.key_points, at_least(0.0));
    field("sac_hypotheses", self.sac_hypotheses, at_least(1.0));
    field("sac_randomness", self.sac_randomness, at_least(1.0));
    field("sac_truncation_m", self.sac_truncation_m, above(0.0));
    field("max_sac_fitness_m2", self.max_sac_fitness_m2, above(0.0));
    field("max_correspondence_m", self.max_correspondence_m, above(0.0));
    field("gicp_iterations", self.gicp_iterations, at_least(1.0));
    field("gicp_translation_epsilon_m", self.gicp_translation_epsilon_m, above(0.0));
    field("gicp_rotation_epsilon", self.gicp_rotation_epsilon, above(0.0));
    field("max_descriptor_mb", self.max_descriptor_mb, at_least(0.0));
    visit_part(self.tests, field);
  }
};

/// The reference: PCL's features and GICP in LAMP's procedure (design of the paper, §III-E). The
/// feature-based stage is sample consensus initial alignment (Rusu et al., ICRA 2009) over FPFH. It has its
/// own random numbers, while PCL uses the process's rand(), and abandons a hypothesis whose error exceeds the
/// best. The refinement is pcl::GeneralizedIterativeClosestPoint with covariances from the normals.
/// Thread-safe; descriptors are computed once per scan. Checks prevent PCL's console messages for invalid
/// input; its verbosity is unchanged.
class LOOPWISE_EXPORT PclRegistrar final : public Registrar {
 public:
  /// \throws OptionError; InputError if `features` is null.
  explicit PclRegistrar(std::shared_ptr<FeatureCache> features, const PclRegistrarOptions& options = {});
  ~PclRegistrar() override;

  [[nodiscard]] std::string_view name() const override { return "pcl"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace loopwise
