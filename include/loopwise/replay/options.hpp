// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/generation/appearance.hpp>
#include <loopwise/optimization/back_end.hpp>
#include <loopwise/prioritization/method.hpp>
#include <loopwise/replay/registration.hpp>

namespace loopwise {

/// Durations of computations on the virtual clock, in mission time.
struct CostModel {
  /// Number of registrations that run at the same time on the clock of the mission.
  std::int64_t workers = 10;
  /// Mission time of one registration on one worker, s.
  double registration_time_s = 1.3;
  /// Mission time of a registration that is refused, in units of registration_time_s. 0: refusals are free,
  /// as if an oracle knew them beforehand; no order of computation can do better than that. Must be 1 with
  /// measured_time.
  double refused_time_share = 1.0;
  /// A registration takes as long as it took on this machine, as recorded with its outcome, instead of
  /// registration_time_s.
  bool measured_time = false;
  /// Mission time of one evaluation while graph information improves its next set, s. As many evaluations run
  /// as fit between two batches.
  double gi_evaluation_time_s = 0.02;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("workers", self.workers, at_least(1));
    field("registration_time_s", self.registration_time_s, above(0.0));
    field("refused_time_share", self.refused_time_share, at_least(0.0));
    field("measured_time", self.measured_time, any_value());
    field("gi_evaluation_time_s", self.gi_evaluation_time_s, above(0.0));
  }
};

/// All options of a replay.
struct ReplayOptions {
  EngineOptions engine;                  ///< Decisions.
  AppearanceOptions appearance;          ///< Candidates by appearance.
  PrioritizationOptions prioritization;  ///< Order of candidates.
  RegistrationOptions registration;      ///< Computation of candidates.
  BackEndOptions back_end;               ///< Estimates.
  CostModel cost;                        ///< Virtual clock.
  /// Number of candidates in a batch. 0: as many as the workers compute in 13 s of mission time, but at most
  /// 100, and at least one for each worker. If times are measured, 0 means 100.
  std::int64_t batch = 0;
  /// The run ends after this number of registrations. 0: no bound.
  std::int64_t max_registrations = 0;
  /// Continue after the last key frame until no candidate is pending.
  bool after_mission = false;
  /// File with pairs from another place recognition, which become candidates too, see read_candidates().
  /// Empty: no such pairs.
  std::string candidates;
  /// Noise added to the odometry: standard deviation of the translation along each axis after 1 m, m. It
  /// grows with the square root of the distance.
  double odometry_noise_m_per_m = 0.0;
  /// Noise added to the odometry: standard deviation of the rotation about each axis after 1 m, rad. It grows
  /// with the square root of the distance.
  double odometry_noise_rad_per_m = 0.0;
  /// File of closures that a person has accepted or rejected (decisions.csv). Empty: no decisions.
  std::string decisions;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("batch", self.batch, at_least(0));
    field("max_registrations", self.max_registrations, at_least(0));
    field("after_mission", self.after_mission, any_value());
    field("candidates", self.candidates, any_value());
    field("odometry_noise_m_per_m", self.odometry_noise_m_per_m, at_least(0.0));
    field("odometry_noise_rad_per_m", self.odometry_noise_rad_per_m, at_least(0.0));
    field("decisions", self.decisions, any_value());
  }

  /// Calls visitor(name, section) for each part with its own fields, see core/options.hpp.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    EngineOptions::visit_sections(self.engine, visitor);
    visitor("appearance", self.appearance);
    PrioritizationOptions::visit_sections(self.prioritization, visitor);
    visitor("registration", self.registration);
    visitor("features", self.registration.features);
    visitor("fast_registrar", self.registration.fast);
    visitor("pcl_registrar", self.registration.pcl);
    visitor("icp_registrar", self.registration.icp);
    BackEndOptions::visit_sections(self.back_end, visitor);
    visitor("cost", self.cost);
    visitor("replay", self);
  }
};

/// Checks every field. \throws OptionError naming "section.field"
LOOPWISE_EXPORT void validate_replay(const ReplayOptions& options);

/// Number of candidates in a batch on the virtual clock: ReplayOptions::batch, or the number that fits the
/// cost model.
[[nodiscard]] LOOPWISE_EXPORT std::size_t batch_size(const ReplayOptions& options);

/// The options as indented JSON: an object of sections for read_config().
[[nodiscard]] LOOPWISE_EXPORT std::string options_json(const ReplayOptions& options);

/// A text of all options that affect results: options_json(), and hashes of the contents of the files that
/// they name, because the contents of a path may change. Unreadable files have a value of their own.
[[nodiscard]] LOOPWISE_EXPORT std::string options_key(const ReplayOptions& options);

}  // namespace loopwise
