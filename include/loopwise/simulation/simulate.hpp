// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/simulation/world.hpp>

namespace loopwise {

/// Beam patterns.
enum class LidarKind {
  kVlp16,   ///< Velodyne VLP-16: 16 beams over ±15°, 0.2° apart in azimuth.
  kOs1_64,  ///< Ouster OS1-64: 64 beams over ±22.5° (the second generation), 1024 columns.
};
[[nodiscard]] inline EnumNames<LidarKind> enum_names(LidarKind) {
  return {{LidarKind::kVlp16, "vlp16"}, {LidarKind::kOs1_64, "os1_64"}};
}

/// Thinning of a sweep.
enum class ScanKind {
  kLamp,  ///< As in LAMP's front end: voxels of adaptive size, then random thinning.
  kRaw,   ///< All returns of the sweep.
};
[[nodiscard]] inline EnumNames<ScanKind> enum_names(ScanKind) {
  return {{ScanKind::kLamp, "lamp"}, {ScanKind::kRaw, "raw"}};
}

/// Options of a simulation. All other parameters of worlds and sensors are fixed in one file, see
/// simulation_parameters_hash().
struct SimulationOptions {
  /// Kind of world.
  WorldKind world = WorldKind::kTunnel;
  /// Distance that all robots drive together, m. 0: the paper's length for the world.
  double length_m = 0.0;
  /// Number of robots. 0: the paper's number for the world.
  int robots = 0;
  /// Beam pattern of the lidar.
  LidarKind lidar = LidarKind::kVlp16;
  /// Kind of scans: downsampled scans, or raw sweeps.
  ScanKind scans = ScanKind::kLamp;
  /// Maximum number of points of a downsampled scan.
  int scan_points = 1500;
  /// Distance driven between consecutive nodes, m.
  double node_spacing_m = 2.0;
  /// Robots drop radio beacons and receive their signals.
  bool radio = true;
  /// Robots are out of range at times and deliver their data later.
  bool communication_gaps = true;
  /// Error of the alignment at the gate, and its stated standard deviation: position, m.
  double prior_position_sigma_m = 0.0016;
  /// Error of the alignment at the gate, and its stated standard deviation: roll and pitch, rad.
  double prior_tilt_sigma_rad = 0.005;
  /// Error of the alignment at the gate, and its stated standard deviation: yaw, rad.
  double prior_yaw_sigma_rad = 0.00041;
  /// Number of threads. 0: one per processor. It changes the run time, never the mission.
  int threads = 0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("world", self.world, any_value());
    field("length_m", self.length_m, between(0.0, 60000.0));
    field("robots", self.robots, between(0, 26));
    field("lidar", self.lidar, any_value());
    field("scans", self.scans, any_value());
    field("scan_points", self.scan_points, between(20, 100000));
    field("node_spacing_m", self.node_spacing_m, between(0.5, 20.0));
    field("radio", self.radio, any_value());
    field("communication_gaps", self.communication_gaps, any_value());
    field("prior_position_sigma_m", self.prior_position_sigma_m, above(0.0));
    field("prior_tilt_sigma_rad", self.prior_tilt_sigma_rad, above(0.0));
    field("prior_yaw_sigma_rad", self.prior_yaw_sigma_rad, above(0.0));
    field("threads", self.threads, between(0, 1024));
  }
};

/// Checks the bounds of the fields, and that each robot drives at least 20 m (and 10 nodes).
/// \throws OptionError naming the field.
LOOPWISE_EXPORT void validate_simulation(const SimulationOptions& options);

/// The options with 0 replaced by the world's own figures. \throws OptionError as validate_simulation.
[[nodiscard]] LOOPWISE_EXPORT SimulationOptions resolved(SimulationOptions options);

/// Truth of one beacon, in the order of Mission::beacons.
struct BeaconTruth {
  std::string beacon;        ///< Its name.
  Eigen::Vector3d position;  ///< World frame, m.
};

/// Truth of one reading, in the order of Mission::radio.
struct ReadingTruth {
  double distance_m = 0.0;  ///< Straight line from beacon to robot.
  int walls = 0;            ///< Walls on that line, counted up to 4.
};

/// A whole mission in memory, with its true values.
struct SimulatedMission {
  SimulationOptions options;  ///< Resolved.
  std::uint64_t seed = 0;     ///< As given.
  /// The mission as from read_mission(): keys are GTSAM symbols of the robots a, b, c, ...; nodes have the
  /// poses of odometry, composed from each robot's prior; odometry edges carry the covariance that the front
  /// end states. The scans are in memory unless they went to a sink.
  Mission mission;
  std::vector<BeaconTruth> beacons;    ///< In the order of Mission::beacons.
  std::vector<ReadingTruth> readings;  ///< In the order of Mission::radio.
  /// By node number: smallest eigenvalue of the mean of n·nᵀ over the full sweep with true normals, at most
  /// 1/3: the constraint of the odometry.
  std::vector<double> observability;
  std::vector<bool> in_corridor;  ///< By node number: between two walls, away from junctions and ends.
  std::uint64_t rays = 0;         ///< Cast for the scans.
};

/// Gets each scan when it is made, from any thread and in any order.
using ScanSink = std::function<void(Key, const PointCloud&)>;

/// Makes a mission: world, routes, motion, scans, drift. A function of (options, seed) alone. `sink`, if
/// given, gets the scans, so that memory stays small; then `mission.scans` is empty. \throws OptionError on
/// bad options; SimulationStopped if a stop is requested; exceptions of the sink.
[[nodiscard]] LOOPWISE_EXPORT SimulatedMission simulate(const SimulationOptions& options, std::uint64_t seed,
                                                        const ProgressCallback& progress = {},
                                                        const StopToken& stop = {},
                                                        const ScanSink& sink = {});

/// Writes the mission to a mission folder, scan by scan. After an exception the output is removed.
/// \returns the mission; its scans are those in the folder.
/// \throws also IoError if the folder exists and is not empty, or cannot be written.
LOOPWISE_EXPORT SimulatedMission simulate_to_folder(const std::filesystem::path& folder,
                                                    const SimulationOptions& options, std::uint64_t seed,
                                                    const ProgressCallback& progress = {},
                                                    const StopToken& stop = {});

/// SHA-256 of the file that fixes the parameters of worlds, sensors and robots; in every mission's
/// provenance.
[[nodiscard]] LOOPWISE_EXPORT std::string_view simulation_parameters_hash();

/// Thrown when a stop was requested before a whole mission existed.
struct LOOPWISE_EXPORT SimulationStopped : Error {
  using Error::Error;
};

}  // namespace loopwise
