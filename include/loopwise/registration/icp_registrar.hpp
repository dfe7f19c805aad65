// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string_view>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

/// Registration `icp`: point-to-point ICP and a bound on the mean squared distance. The defaults are those of
/// SC-A-LOAM.
struct IcpRegistrarOptions {
  /// Maximum distance of matched points, m.
  double max_correspondence_m = 150.0;
  /// Maximum number of iterations.
  int iterations = 100;
  /// ICP ends when a step is shorter, m, and turns by less than as many radians, or when it changes the mean
  /// squared distance of the matches by less than its square.
  double epsilon = 1e-3;
  /// The candidate is refused if the mean squared distance of the source's points from the target is larger,
  /// m².
  double max_fitness_m2 = 0.3;
  /// Standard deviation of every component of a closure, m and rad.
  double sigma = 0.7;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_correspondence_m", self.max_correspondence_m, above(0.0));
    field("iterations", self.iterations, at_least(1.0));
    field("epsilon", self.epsilon, above(0.0));
    field("max_fitness_m2", self.max_fitness_m2, above(0.0));
    field("sigma", self.sigma, above(0.0));
  }
};

/// The registration of open lidar SLAM programs (SC-A-LOAM, LIO-SAM), for comparison: point-to-point ICP
/// (Besl and McKay, PAMI 1992) of the newer scan against the submap of the older node, from the guess, and
/// one test. There is no comparison with other poses, free space or the guess, so that false closures are
/// frequent in look-alike places. Thread-safe.
class LOOPWISE_EXPORT IcpRegistrar final : public Registrar {
 public:
  /// \throws OptionError; InputError if `features` is null.
  explicit IcpRegistrar(std::shared_ptr<FeatureCache> features, const IcpRegistrarOptions& options = {});

  [[nodiscard]] std::string_view name() const override { return "icp"; }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override;

 private:
  std::shared_ptr<FeatureCache> features_;
  IcpRegistrarOptions options_;
};

}  // namespace loopwise
