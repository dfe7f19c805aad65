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

PointCloud moved(const PointCloud& cloud, const Eigen::Isometry3d& T) {
  PointCloud out = cloud;
  for (Eigen::Vector3f& p : out.points) p = (T * p.cast<double>()).cast<float>();
  for (Eigen::Vector3f& n : out.normals) n = (T.linear() * n.cast<double>()).cast<float>();
  return out;
}

int run(const Options& options) {
  const Stopwatch watch;
  Console console(options.common.quiet);
  RegistrationOptions registration = load_config(options.common).replay.registration;
  if (!options.registrar.empty()) {
    registration.registrar = parse_enum<RegistrarKind>("--registrar", options.registrar);
  }

  // The pair as two nodes: the source is the newer one.
  constexpr Key kTarget = 0, kSource = 1;
  const CloudFile source = read_cloud(options.source), target = read_cloud(options.target);
  console.warn(source.problems);
  console.warn(target.problems);
  RegistrationTask task = pair_task(kSource, kTarget, options.seed);
  if (!options.guess.empty()) task.guess_from_to = read_transform(options.guess).inverse();
  const double reading_s = watch.seconds();

  const auto source_cloud = std::make_shared<const PointCloud>(source.cloud);
  const auto target_cloud = std::make_shared<const PointCloud>(target.cloud);
  const auto scans = [&](Key key) { return key == kSource ? source_cloud : target_cloud; };
  const RegistrationResult result = make_registration(registration, scans).registrar->compute(task);

  Json json = Json::object();
  json["status"] = result.verified() ? "verified" : "rejected";
  json["reason"] = enum_name(result.reason);
  json["message"] = result.message;
  std::string text = result.verified()
                         ? "verified\n"
                         : "rejected: " + enum_name(result.reason) + ", " + result.message + "\n";
  json["T_target_source"] = nullptr;
  json["covariance"] = nullptr;
  if (result.T_from_to) {
    const Eigen::Isometry3d T_target_source = result.T_from_to->inverse();
    json["T_target_source"] = row_major(T_target_source.matrix());
    std::string rows = "T_target_source\n";
    for (int r = 0; r < 4; ++r) {
      for (int c = 0; c < 4; ++c) {
        const std::string value = fixed(T_target_source(r, c), 6);
        rows += std::string(value.size() < 13 ? 13 - value.size() : 1, ' ') + value;
      }
      rows += "\n";
    }
    text += rows;
    if (!options.out.empty()) {
      const std::filesystem::path path(options.out);
      const PointCloud cloud = moved(source.cloud, T_target_source);
      path.extension() == ".ply" ? write_ply(path, cloud) : write_pcd(path, cloud);
    }
  } else if (!options.out.empty()) {
    console.warn("no transform was found: " + options.out + " is not written");
  }
  if (result.closure) {
    const Matrix6d covariance =
        se3::covariance_of_inverse(result.closure->T_from_to, result.closure->covariance);
    json["covariance"] = row_major(covariance);
    const Vector6d sigma = covariance.diagonal().cwiseSqrt();
    text += "sigma        " + fixed(sigma[0], 4) + " " + fixed(sigma[1], 4) + " " + fixed(sigma[2], 4) +
            " m, " + fixed(sigma[3], 5) + " " + fixed(sigma[4], 5) + " " + fixed(sigma[5], 5) + " rad\n";
  }
  json["fitness"] = {{"sac_m2", result.sac_fitness_m2}, {"gicp_m2", result.gicp_fitness_m2}};
  json["overlap"] = result.overlap;
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
      "KITTI .bin. A pair that cannot be aligned is a result with a reason, not an error.\n"
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
  command->add_option("--seed", options->seed, "Of all random draws (default 1)")->type_name("S");
  command->add_option("--out", options->out, "Write the aligned source, .pcd or .ply")->type_name("CLOUD");
  add_common_options(*command, options->common);
  command->callback([options, &chosen] { chosen = [options] { return run(*options); }; });
}

}  // namespace loopwise::cli
