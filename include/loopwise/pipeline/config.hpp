// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/engine/engine.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/generation/proximity.hpp>
#include <loopwise/generation/radio.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/optimization/gnc.hpp>
#include <loopwise/optimization/optimizer.hpp>
#include <loopwise/prioritization/graph_information.hpp>
#include <loopwise/prioritization/observability.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/pcl_registrar.hpp>
#include <loopwise/registration/task.hpp>

namespace loopwise {

/// Which implementation computes the candidates.
enum class RegistrarKind {
  kFast,  ///< FastRegistrar
  kPcl,   ///< PclRegistrar, the reference
};
[[nodiscard]] inline EnumNames<RegistrarKind> enum_names(RegistrarKind) {
  return {{RegistrarKind::kFast, "fast"}, {RegistrarKind::kPcl, "pcl"}};
}

/// A replay: method, model of time, disturbances of the odometry.
struct ReplayOptions {
  std::string method = "obs";
  std::int64_t batch = 100;
  double registration_time_s = 1.3;
  bool measured_time = false;
  std::int64_t workers = 10;
  std::int64_t max_registrations = 0;
  std::int64_t thin = 1;
  double gi_evaluation_time_s = 0.02;
  bool after_mission = false;
  RegistrarKind registrar = RegistrarKind::kFast;
  GuessSource guess = GuessSource::kEstimate;
  double odometry_noise_m_per_m = 0.0;
  double odometry_noise_rad_per_m = 0.0;
  std::uint64_t seed = 1;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field(
        "method", self.method, any_value(),
        "What decides the order: odom (no closures), baseline, random, obs, gi, full (obs and gi), rssi, or "
        "several of them joined by +.");
    field("batch", self.batch, at_least(1), "Candidates handed out each time the computation runs dry.");
    field("registration_time_s", self.registration_time_s, above(0.0),
          "Mission time that one registration takes on one worker, s.");
    field("measured_time", self.measured_time, any_value(),
          "A registration takes what it took on this machine, as recorded with its outcome, in place of "
          "registration_time_s.");
    field("workers", self.workers, at_least(1), "Registrations that run at a time on the mission's clock.");
    field("max_registrations", self.max_registrations, at_least(0),
          "The run ends after this many; 0: no bound.");
    field("thin", self.thin, at_least(1), "Keep one candidate in this many, drawn by pair and seed; 1: all.");
    field("gi_evaluation_time_s", self.gi_evaluation_time_s, above(0.0),
          "Mission time of one evaluation while graph information improves its next set, s: as many as fit "
          "between two batches.");
    field("after_mission", self.after_mission, any_value(),
          "Go on after the last key frame until nothing is pending.");
    field("registrar", self.registrar, any_value(), "What computes the candidates: fast or pcl.");
    field("guess", self.guess, any_value(),
          "Relative pose that registrations are given: estimate or odometry.");
    field("odometry_noise_m_per_m", self.odometry_noise_m_per_m, at_least(0.0),
          "Added to the odometry: sigma of each axis after 1 m, m; grows with the root of the distance.");
    field(
        "odometry_noise_rad_per_m", self.odometry_noise_rad_per_m, at_least(0.0),
        "Added to the odometry: sigma about each axis after 1 m, rad; grows with the root of the distance.");
    field("seed", self.seed, at_least(0), "Of everything random.");
  }
};

/// What a back end needs that goes on from its own estimates, of which an early one may have been wrong: it
/// begins with odometry each time, for closures that once bent the map would seem to fit for ever.
[[nodiscard]] inline OptimizerOptions optimizer_for_running_estimates() {
  OptimizerOptions optimization;
  optimization.initialization = Initialization::kOdometry;
  return optimization;
}
/// The same of robust optimisation.
[[nodiscard]] inline GncOptions gnc_for_running_estimates() {
  GncOptions gnc;
  gnc.second_start = true;
  return gnc;
}

/// All options of a run: the sections of a configuration file.
struct Config {
  MissionOptions mission;                      ///< Reading of missions.
  ProximityOptions generation;                 ///< Candidates by proximity.
  RadioOptions radio;                          ///< Candidates by radio beacons.
  FeatureOptions features;                     ///< Scans made ready: voxels, normals, cache.
  CandidatePoolOptions pool;                   ///< Expiry of candidates.
  ObservabilityPriorityOptions observability;  ///< Prioritiser `obs`.
  GraphInformationOptions graph_information;   ///< Prioritiser `gi`.
  ClosureModelOptions closure_model;           ///< What `gi` takes a candidate's closure for.
  AnnealingOptions annealing;                  ///< Simulated annealing of `gi`.
  GreedyOptions greedy;                        ///< Greedy choice of `gi`.
  TaskOptions task;                            ///< Scans and guesses that a registration is given.
  FastRegistrarOptions fast_registrar;         ///< Registration `fast`.
  PclRegistrarOptions pcl_registrar;           ///< Registration `pcl`, the reference.
  OptimizerOptions optimization = optimizer_for_running_estimates();  ///< The back end.
  GncOptions gnc = gnc_for_running_estimates();                       ///< Its robust weights.
  ReplayOptions replay;                                               ///< The replay itself.

  /// Calls visitor(name, section) for each, as core/options.hpp does for fields.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    visitor("mission", self.mission);
    visitor("generation", self.generation);
    visitor("radio", self.radio);
    visitor("features", self.features);
    visitor("pool", self.pool);
    visitor("observability", self.observability);
    visitor("graph_information", self.graph_information);
    visitor("closure_model", self.closure_model);
    visitor("annealing", self.annealing);
    visitor("greedy", self.greedy);
    visitor("task", self.task);
    visitor("fast_registrar", self.fast_registrar);
    visitor("pcl_registrar", self.pcl_registrar);
    visitor("optimization", self.optimization);
    visitor("gnc", self.gnc);
    visitor("replay", self.replay);
  }
};

/// \throws OptionError naming "section.field".
LOOPWISE_EXPORT void validate_config(const Config& config);

/// Reads {"generation": {"rate_m": 0.3}, ...} over `config`; what it leaves out stays. In the section
/// "generation" the key "preset" names a proximity preset that the other keys then change. \throws IoError;
/// ParseError naming the line; OptionError naming "section.field".
LOOPWISE_EXPORT void read_config(const std::filesystem::path& path, Config& config);

/// The same from a JSON text; `source` stands in errors for the file's name.
LOOPWISE_EXPORT void parse_config(std::string_view json, const std::string& source, Config& config);

/// Sets one field, as `--set generation.rate_m=0.3` does. \throws OptionError
LOOPWISE_EXPORT void set_config_option(const std::string& assignment, Config& config);

/// The whole configuration as indented JSON that read_config() takes.
[[nodiscard]] LOOPWISE_EXPORT std::string config_json(const Config& config);

/// A text for all that results depend on in a configuration: config_json(), and hashes of the content of the
/// files that its options name, since other content may come to lie at the same path. A file that cannot be
/// read counts as such.
[[nodiscard]] LOOPWISE_EXPORT std::string config_key(const Config& config);

/// One option for people: "generation.rate_m", its value, bounds and meaning.
struct ConfigEntry {
  std::string name;    ///< "section.field"
  std::string type;    ///< As OptionDescription::type.
  std::string value;   ///< As JSON.
  std::string bounds;  ///< As OptionDescription::bounds.
  std::string doc;     ///< Meaning and unit.
};
/// Every option with its present value, by section.
[[nodiscard]] LOOPWISE_EXPORT std::vector<ConfigEntry> describe_config(const Config& config);

/// The methods that ReplayOptions::method names.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::string> method_names();

/// The prioritisers of a method by name, in the order of their turns: "full" and "gi+obs" are obs and gi,
/// "odom" is none. \throws OptionError naming the methods there are.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::string> method_parts(const std::string& method);

/// Whether a method has candidates of radio beacons. \throws OptionError as method_parts()
[[nodiscard]] LOOPWISE_EXPORT bool uses_radio(const std::string& method);

/// The registrar of a kind over these features. \throws OptionError if this build has it not.
[[nodiscard]] LOOPWISE_EXPORT std::shared_ptr<const Registrar> make_registrar(
    RegistrarKind kind, const Config& config, std::shared_ptr<FeatureCache> features);

/// The options of the engine that a configuration asks for.
[[nodiscard]] LOOPWISE_EXPORT EngineOptions engine_options(const Config& config);

/// The smallest eigenvalue of a scan's observability, from the cache; 0 if the scan cannot be read.
/// `features` must outlive it.
[[nodiscard]] LOOPWISE_EXPORT ObservabilityPrioritizer::Eigenvalue observability_of(
    FeatureCache& features, ObservabilityVariant variant);

/// The prioritisers of a method, joined in a queue. `eigenvalue` serves the observability score.
/// \throws OptionError naming the methods there are.
[[nodiscard]] LOOPWISE_EXPORT RoundRobinQueue make_queue(
    const Config& config, const Robots& robots, const ObservabilityPrioritizer::Eigenvalue& eigenvalue);

}  // namespace loopwise
