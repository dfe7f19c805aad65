// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The frozen parameters of the simulated worlds, sensors and robots. They come from the literature and were
/// fixed before any method was run on the missions; nothing here may be tuned so that a method looks good.
/// The SHA-256 of this file stands in the provenance of every mission, so a change makes other missions.
///
/// Sources, by the short names used below:
///   [paper]  Denniston et al., Loop Closure Prioritization for Efficient and Scalable Multi-Robot SLAM, RA-L
///   2022 [LAMP]   Chang et al., LAMP 2.0, RA-L 2022, and its published configuration [LOCUS]  Reinke et al.,
///   LOCUS 2.0, RA-L 2022 [SubT]   Ebadi et al., Present and Future of SLAM in Extreme Underground
///   Environments, T-RO 2024 [NIOSH]  Esterhuizen et al., Pillar and Roof Span Design Guidelines for
///   Underground Stone Mines, 2011 [Radio]  Forooshani et al., A Survey of Wireless Communications and
///   Propagation Modeling in Underground Mines,
///            IEEE Communications Surveys & Tutorials, 2013
///   [VLP16]  Velodyne VLP-16 user manual 63-9243;  [OS1]  Ouster OS1 datasheet, second generation
///   [Degen]  Zhang, Kaess, Singh, On Degeneracy of Optimization-based State Estimation Problems, ICRA 2016
#pragma once

#include <array>

namespace loopwise::simulation_parameters {

struct Range {
  double low;
  double high;
};

/// Size of the paper's data sets [paper], and how much of the driven length the passages are: a team that
/// explores and comes back passes each about twice.
struct MissionSize {
  double length_m;
  int robots;
};
inline constexpr MissionSize kTunnelSize{2500.0, 2};
inline constexpr MissionSize kUrbanSize{1500.0, 3};
inline constexpr MissionSize kFinalsSize{1200.0, 4};
inline constexpr MissionSize kMineSize{6000.0, 4};
inline constexpr double kPassagesPerDrivenLength = 0.5;

/// Roughness of a surface: gradient noise summed over three scales. The amplitudes are root mean squares.
struct Roughness {
  std::array<double, 3> amplitude_m;
  std::array<double, 3> wavelength_m;
  double floor_share;  ///< Of the walls' amplitude: floors are driven on.
};
inline constexpr Roughness kCoal{{0.035, 0.022, 0.012}, {5.0, 1.8, 0.8}, 0.4};
inline constexpr Roughness kLimestone{{0.070, 0.045, 0.025}, {8.0, 3.0, 1.3}, 0.3};
inline constexpr Roughness kCave{{0.160, 0.090, 0.040}, {5.0, 2.0, 0.8}, 0.3};
inline constexpr Roughness kConcrete{{0.012, 0.008, 0.005}, {6.0, 2.0, 0.8}, 0.3};

/// Cells of the surface extraction, m: fine enough for the shortest wavelength, coarse enough for memory.
inline constexpr double kTunnelCell = 0.25;
inline constexpr double kUrbanCell = 0.20;
inline constexpr double kFinalsCell = 0.25;
inline constexpr double kMineCell = 0.45;

/// Coal mine: entries of 3-5 m by about 2.2 m, 15 m apart, joined by cross-cuts.
struct Tunnel {
  Range width_m{3.2, 4.8};
  Range height_m{2.1, 2.5};
  double roof_sag_m = 0.25;
  double entry_spacing_m = 15.0;
  Range cross_cut_spacing_m{25.0, 55.0};
  double panel_length_m = 115.0;
  double bleeder_share = 0.4;  ///< Of neighbouring panels whose far ends are joined.
  Range face_m{4.0, 11.0};     ///< Beyond the last cross-cut.
  double meander_m = 0.35;
  double undulation_m = 1.5;  ///< Amplitude of the seam's height over some 120 m.
  double clearance_m = 1.15;  ///< From a robot's centre to the ribs, at least.
  double prop_spacing_m = 22.0;
  double pipe_radius_m = 0.09;
};
inline constexpr Tunnel kTunnel{};

/// Room-and-pillar limestone mine [NIOSH]: spans of 10-20 m, some 6 m high, pillars of 10-20 m.
struct Mine {
  Range width_m{10.0, 17.0};
  Range height_m{5.5, 6.8};
  double roof_sag_m = 0.4;
  Range pillar_pitch_m{28.0, 36.0};
  double pillar_jitter_m = 2.5;
  double unmined_share = 0.14;  ///< Of the drifts between pillars that were never cut.
  double undulation_m = 2.0;
  double clearance_m = 3.4;  ///< From a robot's centre to the ribs, at least: loose rock falls there.
  double rubble_spacing_m = 14.0;
};
inline constexpr Mine kMine{};

/// Power plant: blocks of rooms and halls between corridors, on two floors.
struct Urban {
  Range block_x_m{15.0, 19.0};
  Range block_y_m{12.0, 15.0};
  Range corridor_width_m{1.8, 2.6};
  double wall_m = 0.45;
  double room_height_m = 3.2;
  double hall_height_m = 8.0;
  double storey_m = 5.2;
  double door_width_m = 1.1;
  double door_height_m = 2.15;
  double hall_share = 0.3;
  double inner_door_share = 0.4;
  Range column_spacing_m{4.5, 6.0};
  double step_rise_m = 0.175;
};
inline constexpr Urban kUrban{};

/// Cave: tubes and chambers whose size changes on the way.
struct Cave {
  Range width_m{2.2, 6.0};
  Range height_m{2.2, 5.0};
  Range chamber_radius_m{3.0, 7.0};
  Range pitch_m{15.0, 20.0};
  double jitter_m = 3.5;
  double meander_m = 1.6;
  double undulation_m = 1.6;
  double closed_share = 0.25;
};
inline constexpr Cave kCaveShape{};

/// Beam patterns. Range noise 1 sigma 2-3 cm [VLP16] [OS1]; the share of lost returns grows with range and
/// with grazing incidence, as on dark, wet rock.
struct Lidar {
  int beams;
  double elevation_low_deg;
  double elevation_high_deg;
  int columns;
  double min_range_m;
  double max_range_m;
  double range_sigma_m;
};
inline constexpr Lidar kVlp16{16, -15.0, 15.0, 1800, 0.5, 100.0, 0.025};
inline constexpr Lidar kOs1_64{64, -22.5, 22.5, 1024, 0.5, 120.0, 0.020};
inline constexpr double kRangeQuantum = 0.002;
inline constexpr double kDropAlways = 0.01;
inline constexpr double kDropAtMaxRange = 0.5;  ///< Grows with the square of the range.
inline constexpr double kDropGrazingCosine =
    0.15;  ///< Below this cosine of incidence returns begin to be lost,
inline constexpr double kDropGrazingNone = 0.01;  ///< below this one all are.

/// LAMP's thinning: voxels of 0.1-0.8 m, from 0.45 m, towards five times the points kept [LAMP].
inline constexpr double kVoxelStart = 0.45;
inline constexpr Range kVoxelRange{0.1, 0.8};
inline constexpr double kVoxelQuantum = 0.01;
inline constexpr int kVoxelRounds = 6;
inline constexpr double kVoxelTargetPerPoint = 5.0;

/// A platform: how it moves, and how its lidar-inertial odometry drifts. Drift of 0.3-2 % of the distance
/// [SubT] [LOCUS], dominated by yaw, larger on legs [paper, Table II]. White noise is per square root of a
/// metre.
struct Platform {
  double speed_mps;
  double lidar_height_m;
  double height_jitter_m;
  double tilt_jitter_rad;
  double radius_m;
  double white_m;             ///< Translation, m per sqrt(m), each axis.
  double white_yaw_rad;       ///< rad per sqrt(m).
  double white_tilt_rad;      ///< Roll and pitch, rad per sqrt(m), pulled back by gravity.
  double yaw_bias_rad_per_m;  ///< Sigma of a bias that wanders over `bias_length_m`.
  double scale_bias;          ///< Sigma of the error in scale.
  double bias_length_m;
};
inline constexpr Platform kGround{0.95,   0.85,   0.01,    0.012,  0.45, 0.006,
                                  0.0016, 0.0008, 0.00022, 0.0015, 60.0};
inline constexpr Platform kLegged{0.75,   0.65,   0.03,    0.035,  0.35, 0.012,
                                  0.0042, 0.0016, 0.00060, 0.0030, 40.0};
inline constexpr double kGravityLength = 12.0;  ///< Over which roll and pitch errors are pulled back, m.

/// Low observability [Degen]: along the weakest direction the error grows with (reference /
/// eigenvalue)^(1/2), up to a factor; where it is below the burst threshold, bias bursts begin now and then.
inline constexpr double kDegeneracyReference =
    0.10;  ///< Smallest eigenvalue of the mean of n·nT, at most 1/3.
inline constexpr double kDegeneracyMaxFactor = 5.0;
inline constexpr double kBurstBelow = 0.05;
inline constexpr double kBurstsPerMetre = 1.0 / 90.0;
inline constexpr Range kBurstLength{6.0, 16.0};
inline constexpr double kBurstSlip =
    0.04;  ///< Sigma of the share of the way that is lost or gained in a burst.
inline constexpr double kBurstYawRadPerMetre = 0.0015;

/// Covariances that the front end states for a step of 2 m, growing with its length: white noise of good
/// times only, as lidar odometry states its own [LAMP]; biases, bursts and degeneracy are not in it.
inline constexpr double kStatedSigmaM = 0.010;
inline constexpr double kStatedSigmaYawRad = 0.0025;
inline constexpr double kStatedSigmaTiltRad = 0.0025;

/// Radio at 2.4 GHz [Radio]: path loss 40 dB at 1 m and 10·n·log10(d); n is a little above 2 in wide drifts,
/// below it in tunnels that guide the wave; walls, and shadowing that is correlated along the way and fading
/// per receiver.
struct RadioWorld {
  double exponent;
  double wall_db;
};
inline constexpr RadioWorld kTunnelRadio{1.9, 25.0};
inline constexpr RadioWorld kUrbanRadio{2.3, 12.0};
inline constexpr RadioWorld kFinalsRadio{2.1, 20.0};
inline constexpr RadioWorld kMineRadio{2.2, 25.0};
inline constexpr double kRadioLossAt1m = 40.0;
inline constexpr double kShadowingSigmaDb = 3.5;
inline constexpr double kShadowingLength = 8.0;
inline constexpr double kFadingSigmaDb = 2.0;
inline constexpr double kTransmitDbm = 28.35;  ///< 684 mW [LAMP].
inline constexpr double kSensitivityDbm = -95.0;
inline constexpr double kMissingShare = 0.04;
inline constexpr int kReceivers = 2;  ///< Antennas [LAMP].
inline constexpr int kMaxWalls = 4;
inline constexpr double kRadioRange = 150.0;
inline constexpr double kBeaconHeight = 0.3;

/// Beacons: each robot carries some and drops one where it would lose the network; the network reaches so far
/// along the passages from the gate or a beacon. Besides, links fail for a while now and then.
inline constexpr int kBeaconsPerRobot = 6;
inline constexpr Range kDropDistance{30.0, 50.0};
inline constexpr double kNetworkReach = 60.0;
inline constexpr double kOutagesPerSecond = 1.0 / 300.0;
inline constexpr Range kOutageSeconds{15.0, 90.0};

/// Time.
inline constexpr double kStartDelaySeconds = 25.0;  ///< From one robot's start to the next.
inline constexpr double kDropSeconds = 8.0;
inline constexpr long long kEpochSeconds = 1582200000;

}  // namespace loopwise::simulation_parameters
