// SPDX-License-Identifier: BSD-3-Clause
#include <nlohmann/json.hpp>

#include <loopwise/core/clock.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/text_tables.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/json_values.hpp>
#include <loopwise/io/trajectory.hpp>
#include <loopwise/replay/cloud_pair.hpp>

#include "command.hpp"
#include "mission_options.hpp"
#include "pose_text.hpp"

namespace loopwise::cli {
namespace {

struct RegisterCommand {
  CommonOptions common;
  std::string source, target, guess, registrar, out;
  MissionArguments reading;
  std::uint64_t seed = 1;
};

CloudFile read(const std::string& path, const Config& config, Console& console) {
  CloudFile file = read_cloud(path, config.mission.bin_layout);
  console.warn(file.problems);
  return file;
}

/// Reports the pose, and writes the aligned cloud if requested.
void report_pose(const RegisterCommand& options, const CloudPairResult& pair, const PointCloud& source,
                 const PointCloud& target, Json& json, std::string& text) {
  json["T_target_source"] = row_major_json(pair.T_coordinates->matrix());
  json["T_target_source_about_origin"] = row_major_json(pair.T_origins->matrix());
  text += pose_text(*pair.T_coordinates, *pair.T_origins, pair.origins);
  if (!options.out.empty()) {
    const std::filesystem::path path(options.out);
    if (!pair.result.verified()) text += "aligned      " + options.out + " has the pose that was rejected\n";
    const PointCloud cloud = transformed(source, *pair.T_clouds, target.origin);
    path.extension() == ".ply" ? write_ply(path, cloud) : write_pcd(path, cloud);
    if (!cloud.origin.isZero(0.0)) {
      text += "aligned      " + options.out + " is relative to " + point_text(cloud.origin) +
              " m of the target, as a comment in it says\n";
    }
  }
  if (!pair.covariance) return;
  json["covariance"] = row_major_json(*pair.covariance);
  const Vector6d sigma = pair.covariance->diagonal().cwiseSqrt();
  text += "sigma        " + fixed(sigma[0], 4) + " " + fixed(sigma[1], 4) + " " + fixed(sigma[2], 4) +
          " m, " + fixed(sigma[3], 5) + " " + fixed(sigma[4], 5) + " " + fixed(sigma[5], 5) + " rad\n";
}

int run_register(const RegisterCommand& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  const std::filesystem::path ending = std::filesystem::path(options.out).extension();
  if (!options.out.empty() && ending != ".ply" && ending != ".pcd")
    throw OptionError("--out " + options.out + ": must end in .pcd or .ply");
  Config config = load_config(options.common);
  apply(options.reading, config);
  RegistrationOptions& registration = config.replay.registration;
  if (!options.registrar.empty()) {
    registration.registrar = parse_enum<RegistrarKind>("--registrar", options.registrar);
  }
  const CloudFile source = read(options.source, config, console),
                  target = read(options.target, config, console);
  std::optional<Eigen::Isometry3d> guess;
  if (!options.guess.empty()) guess = read_transform(options.guess);
  const double reading_s = watch.seconds();
  const CloudPairResult pair =
      register_clouds(std::make_shared<const PointCloud>(source.cloud),
                      std::make_shared<const PointCloud>(target.cloud), registration, guess, options.seed);
  const RegistrationResult& result = pair.result;
  Problems problems;
  const double max_range_m = registration.features.max_range_m;
  count_far_points(problems, options.source, pair.far_points_source, max_range_m);
  count_far_points(problems, options.target, pair.far_points_target, max_range_m);
  console.warn(problems);
  problems.add(source.problems);
  problems.add(target.problems);

  Json json = {
      {"status", result.verified() ? "verified" : "rejected"},
      {"reason", enum_name(result.reason)},
      {"message", result.message},
      {"T_target_source", nullptr},
      {"origin_m",
       {{"target", row_major_json(pair.origins.target)}, {"source", row_major_json(pair.origins.source)}}},
      {"T_target_source_about_origin", nullptr},
      {"covariance", nullptr}};
  std::string text = result.verified()
                         ? "verified\n"
                         : "rejected: " + enum_name(result.reason) + ", " + result.message + "\n";
  if (pair.T_clouds) {
    report_pose(options, pair, source.cloud, target.cloud, json, text);
  } else if (!options.out.empty()) {
    console.warn("no transform was found: " + options.out + " is not written");
  }
  json["fitness"] = {{"sac_m2", result.sac_fitness_m2}, {"gicp_m2", result.gicp_fitness_m2}};
  json["overlap"] = result.overlap;
  json["problems"] = problems_json(problems);
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

void add_register(Command& app, Action& chosen) {
  const auto options = std::make_shared<RegisterCommand>();
  Command* command = app.add_subcommand("register", "Align two point clouds");
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
  add_bin_layout_option(*command, options->reading.bin_layout);
  add_seed_option(*command, options->seed);
  command->add_option("--out", options->out, "Write the aligned source, .pcd or .ply")
      ->type_name("CLOUD")
      ->check(not_standard_output());
  finish_command(*command, options, run_register, chosen);
}

}  // namespace loopwise::cli
