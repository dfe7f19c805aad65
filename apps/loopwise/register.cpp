// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/trajectory.hpp>

#include "command.hpp"

namespace loopwise::cli {
namespace {

struct Options {
  CommonOptions common;
  std::string source;
  std::string target;
  std::string guess;
  std::string registrar;
  std::string bin_layout;
  std::string out;
  std::uint64_t seed = 1;
};

template <class Matrix>
Json row_major(const Matrix& matrix) {
  Json list = Json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) list.push_back(matrix(r, c));
  }
  return list;
}

/// The source moved by T, with coordinates relative to the target's origin.
PointCloud moved(const PointCloud& cloud, const Eigen::Isometry3d& T, const Eigen::Vector3d& origin) {
  PointCloud out = cloud;
  out.origin = origin;
  for (Eigen::Vector3f& p : out.points) p = (T * p.cast<double>()).cast<float>();
  for (Eigen::Vector3f& n : out.normals) n = (T.linear() * n.cast<double>()).cast<float>();
  return out;
}

/// The points that a reported relative pose refers to, in the coordinates of each file.
struct Origins {
  Eigen::Vector3d target, source;

  [[nodiscard]] bool zero() const { return target.isZero(0.0) && source.isZero(0.0); }
  /// Converts a pose that refers to other points; it maps the files' coordinates in the same way.
  [[nodiscard]] Eigen::Isometry3d from(const Origins& other, const Eigen::Isometry3d& pose) const {
    return Eigen::Translation3d(other.target - target) * pose * Eigen::Translation3d(source - other.source);
  }
  /// The covariance of that pose; both use right perturbations.
  [[nodiscard]] Matrix6d covariance_from(const Origins& other, const Matrix6d& covariance) const {
    const Matrix6d adjoint = se3::adjoint(Eigen::Isometry3d(Eigen::Translation3d(other.source - source)));
    return adjoint * covariance * adjoint.transpose();
  }
};

/// One common point if both clouds share their coordinates: the reported pose is then their difference.
Origins origins_to_report(const Origins& of_clouds) {
  constexpr double kSameCoordinates_m = 1000.0;
  const bool shared = (of_clouds.target - of_clouds.source).norm() < kSameCoordinates_m;
  return shared ? Origins{of_clouds.target, of_clouds.target} : of_clouds;
}

std::string matrix_text(const std::string& title, const Eigen::Isometry3d& T, int decimals) {
  const auto width = static_cast<std::size_t>(decimals) + 7;
  std::string rows = title + "\n";
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 4; ++c) {
      const std::string value = fixed(T(r, c), decimals);
      rows += std::string(value.size() < width ? width - value.size() : 1, ' ') + value;
    }
    rows += "\n";
  }
  return rows;
}

std::string point_text(const Eigen::Vector3d& p) {
  return fixed(p.x(), 0) + " " + fixed(p.y(), 0) + " " + fixed(p.z(), 0);
}

/// The pose in the files' coordinates and, if these are far from zero, about the origins.
std::string pose_text(const Eigen::Isometry3d& T_files, const Eigen::Isometry3d& T_origins,
                      const Origins& origins) {
  if (origins.zero()) return matrix_text("T_target_source", T_files, 6);
  // The 12th digit of a rotation moves points at a distance of 5000 km by 5 micrometres.
  std::string text = matrix_text("T_target_source, in the coordinates of the files", T_files, 12);
  text += "origin       " + point_text(origins.target) + " m";
  if (origins.target != origins.source)
    text += " in the target, " + point_text(origins.source) + " m in the source";
  return text + ": the following values refer to it\n" +
         matrix_text("T_target_source, about the origin", T_origins, 6);
}

CloudFile read(const std::string& path, const Config& config, Console& console) {
  CloudFile file = read_cloud(path, config.mission.bin_layout);
  console.warn(file.problems);
  return file;
}

/// Counts problems of reading, and points that the registration leaves out.
Problems problems_of(const Registration& registration, const std::vector<std::pair<std::string, Key>>& clouds,
                     double max_range_m) {
  Problems problems;
  for (const auto& [name, key] : clouds) {
    count_far_points(problems, name, registration.features->get(key)->far_points, max_range_m);
  }
  return problems;
}

/// The two clouds and the origins of their coordinates.
struct Clouds {
  CloudFile source, target;
  Origins files{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()}, clouds, reported;
};

// Keys of the pair as two nodes: the source is the newer one.
constexpr Key kTarget = 0, kSource = 1;

Clouds read_clouds(const Options& options, const Config& config, Console& console) {
  Clouds out;
  out.source = read(options.source, config, console);
  out.target = read(options.target, config, console);
  out.clouds = {out.target.cloud.origin, out.source.cloud.origin};
  out.reported = origins_to_report(out.clouds);
  return out;
}

/// Reports the pose, and writes the aligned cloud if requested.
void report_pose(const Options& options, const Clouds& pair, const Eigen::Isometry3d& T_clouds, Json& json,
                 std::string& text) {
  const Eigen::Isometry3d T_files = pair.files.from(pair.clouds, T_clouds),
                          T_reported = pair.reported.from(pair.clouds, T_clouds);
  json["T_target_source"] = row_major(T_files.matrix());
  json["T_target_source_about_origin"] = row_major(T_reported.matrix());
  text += pose_text(T_files, T_reported, pair.reported);
  if (options.out.empty()) return;
  const std::filesystem::path path(options.out);
  const PointCloud cloud = moved(pair.source.cloud, T_clouds, pair.target.cloud.origin);
  path.extension() == ".ply" ? write_ply(path, cloud) : write_pcd(path, cloud);
  if (!cloud.origin.isZero(0.0)) {
    text += "aligned      " + options.out + " is relative to " + point_text(cloud.origin) +
            " m of the target, as a comment in it says\n";
  }
}

void report_covariance(const Clouds& pair, const LoopClosure& closure, Json& json, std::string& text) {
  const Matrix6d of_inverse = se3::covariance_of_inverse(closure.T_from_to, closure.covariance);
  const Matrix6d covariance = pair.reported.covariance_from(pair.clouds, of_inverse);
  json["covariance"] = row_major(covariance);
  const Vector6d sigma = covariance.diagonal().cwiseSqrt();
  text += "sigma        " + fixed(sigma[0], 4) + " " + fixed(sigma[1], 4) + " " + fixed(sigma[2], 4) +
          " m, " + fixed(sigma[3], 5) + " " + fixed(sigma[4], 5) + " " + fixed(sigma[5], 5) + " rad\n";
}

int run(const Options& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  Config config = load_config(options.common);
  apply_bin_layout(options.bin_layout, config);
  RegistrationOptions registration = config.replay.registration;
  if (!options.registrar.empty()) {
    registration.registrar = parse_enum<RegistrarKind>("--registrar", options.registrar);
  }
  const Clouds pair = read_clouds(options, config, console);
  RegistrationTask task = pair_task(kSource, kTarget, options.seed);
  if (!options.guess.empty()) {
    task.guess_from_to = pair.clouds.from(pair.files, read_transform(options.guess)).inverse();
  }
  const double reading_s = watch.seconds();

  const auto source_cloud = std::make_shared<const PointCloud>(pair.source.cloud);
  const auto target_cloud = std::make_shared<const PointCloud>(pair.target.cloud);
  const auto scans = [&](Key key) { return key == kSource ? source_cloud : target_cloud; };
  const Registration made = make_registration(registration, scans);
  const RegistrationResult result = made.registrar->compute(task);
  Problems problems = problems_of(made, {{options.source, kSource}, {options.target, kTarget}},
                                  registration.features.max_range_m);
  console.warn(problems);
  problems.add(pair.source.problems);
  problems.add(pair.target.problems);

  Json json = Json::object();
  json["status"] = result.verified() ? "verified" : "rejected";
  json["reason"] = enum_name(result.reason);
  json["message"] = result.message;
  std::string text = result.verified()
                         ? "verified\n"
                         : "rejected: " + enum_name(result.reason) + ", " + result.message + "\n";
  json["T_target_source"] = nullptr;
  json["origin_m"] = {{"target", row_major(pair.reported.target)},
                      {"source", row_major(pair.reported.source)}};
  json["T_target_source_about_origin"] = nullptr;
  json["covariance"] = nullptr;
  if (result.T_from_to) {
    report_pose(options, pair, result.T_from_to->inverse(), json, text);
  } else if (!options.out.empty()) {
    console.warn("no transform was found: " + options.out + " is not written");
  }
  if (result.closure) report_covariance(pair, *result.closure, json, text);
  json["fitness"] = {{"sac_m2", result.sac_fitness_m2}, {"gicp_m2", result.gicp_fitness_m2}};
  json["overlap"] = result.overlap;
  json["problems"] = Json::array();
  for (const Problem& problem : problems.all()) json["problems"].push_back(to_string(problem));
  json["seconds"] = {{"total", watch.seconds()},
                     {"reading", reading_s},
                     {"features", result.features_s},
                     {"global", result.global_s},
                     {"refine", result.refine_s}};
  text += "fitness      " + fixed(result.gicp_fitness_m2, 4) + " m^2, overlap " + fixed(result.overlap, 3) +
          "\n" + "time         " + fixed(result.features_s, 3) + " s features, " + fixed(result.global_s, 3) +
          " s global, " + fixed(result.refine_s, 3) + " s refinement\n";
  print_results(options.common, json, text);
  return kDone;
}

}  // namespace

void add_register(CLI::App& app, Action& chosen) {
  const auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("register", "Align two point clouds");
  command->footer(
      "Finds T_target_source, which maps points of the source into the frame of the target. Clouds are .pcd, "
      ".ply or\n"
      ".bin. A pair that cannot be aligned is a result with a reason, not an error.\n"
      "For clouds in world coordinates the pose is also printed about a point near them; sigma refers to "
      "it.\n"
      "  loopwise register source.pcd target.pcd --out aligned.ply");
  command->add_option("source", options->source, "Cloud to move")->required()->type_name("SOURCE");
  command->add_option("target", options->target, "Cloud that stays")->required()->type_name("TARGET");
  command
      ->add_option(
          "--guess", options->guess,
          "File with T_target_source to start from: 4x4 or 3x4 numbers; results far from it are refused")
      ->type_name("T.txt");
  command->add_option("--registrar", options->registrar, "Which implementation: fast (default) or pcl")
      ->type_name("WORD");
  add_bin_layout_option(*command, options->bin_layout);
  command->add_option("--seed", options->seed, "Seed of all random draws (default 1)")
      ->type_name("S")
      ->check(not_negative());
  command->add_option("--out", options->out, "Write the aligned source, .pcd or .ply")
      ->type_name("CLOUD")
      ->check(not_standard_output());
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
