// SPDX-License-Identifier: BSD-3-Clause
#pragma once

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
  std::int64_t workers = 10;
  double registration_time_s = 1.3;
  double refused_time_share = 1.0;
  bool measured_time = false;
  double gi_evaluation_time_s = 0.02;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("workers", self.workers, at_least(1), "Registrations that run at a time on the mission's clock.");
    field("registration_time_s", self.registration_time_s, above(0.0),
          "Mission time that one registration takes on one worker, s.");
    field("refused_time_share", self.refused_time_share, at_least(0.0),
          "Mission time of a registration that is refused, in units of registration_time_s. 0: refusals are "
          "free, as if an oracle knew them beforehand; no order of computation can do better than that. "
          "1 with measured_time.");
    field(
        "measured_time", self.measured_time, any_value(),
        "A registration takes as long as it took on this machine, as recorded with its outcome, in place of "
        "registration_time_s.");
    field("gi_evaluation_time_s", self.gi_evaluation_time_s, above(0.0),
          "Mission time of one evaluation while graph information improves its next set, s: as many as fit "
          "between two batches.");
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
  std::int64_t batch = 100;
  std::int64_t max_registrations = 0;
  bool after_mission = false;
  std::string candidates;
  double odometry_noise_m_per_m = 0.0;
  double odometry_noise_rad_per_m = 0.0;
  std::string decisions;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("batch", self.batch, at_least(1), "Size of a batch of candidates.");
    field("max_registrations", self.max_registrations, at_least(0),
          "The run ends after this number of registrations; 0: no bound.");
    field("after_mission", self.after_mission, any_value(),
          "Continue after the last key frame until no candidate is pending.");
    field("candidates", self.candidates, any_value(),
          "A file with pairs of another place recognition that are candidates too, see read_candidates(); "
          "empty: no such pairs.");
    field("odometry_noise_m_per_m", self.odometry_noise_m_per_m, at_least(0.0),
          "Added to the odometry: sigma of each axis after 1 m, m; grows with the root of the distance.");
    field(
        "odometry_noise_rad_per_m", self.odometry_noise_rad_per_m, at_least(0.0),
        "Added to the odometry: sigma about each axis after 1 m, rad; grows with the root of the distance.");
    field("decisions", self.decisions, any_value(),
          "File of closures that a person has accepted or rejected (decisions.csv); empty: no decisions.");
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
    BackEndOptions::visit_sections(self.back_end, visitor);
    visitor("cost", self.cost);
    visitor("replay", self);
  }
};

/// Checks every field. \throws OptionError naming "section.field"
LOOPWISE_EXPORT void validate_replay(const ReplayOptions& options);

/// The options as indented JSON: an object of sections for read_config().
[[nodiscard]] LOOPWISE_EXPORT std::string options_json(const ReplayOptions& options);

/// A text of all options that affect results: options_json(), and hashes of the contents of the files that
/// they name, because the contents of a path may change. Unreadable files have a value of their own.
[[nodiscard]] LOOPWISE_EXPORT std::string options_key(const ReplayOptions& options);

}  // namespace loopwise
