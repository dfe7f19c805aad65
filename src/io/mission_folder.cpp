// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/json_options.hpp>

#include "cloud_points.hpp"
#include "g2o_text.hpp"
#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFormat = "loopwise-mission";
constexpr int kVersion = 1;

const std::vector<std::string> kStampColumns = {"key", "stamp_ns"};
const std::vector<std::string> kPriorColumns = {"key", "x",  "y",  "z",  "qx",  "qy",  "qz",
                                                "qw",  "sx", "sy", "sz", "srx", "sry", "srz"};
const std::vector<std::string> kRadioColumns = {"key", "beacon", "transmit_dbm", "receiver", "receive_dbm"};
const std::vector<std::string> kBeaconColumns = {"beacon", "robot", "drop_key", "stamp_ns"};

/// Paths of the parts of a mission within its folder.
struct Files {
  fs::path graph = "graph.g2o";
  fs::path stamps = "stamps.csv";
  fs::path priors = "priors.csv";
  fs::path scans = "scans";
  fs::path radio = "radio.csv";
  fs::path beacons = "beacons.csv";
  fs::path ranges = parts::kRanges;
  fs::path gravity = parts::kGravity;
  fs::path odometry = parts::kOdometry;
  fs::path ground_truth = "ground_truth.g2o";
  fs::path reference = "reference.g2o";
};

/// Reads mission.json; every error names the file and the path of the value in it.
class FolderDescription {
 public:
  explicit FolderDescription(const fs::path& file) : file_(file.string()), json_(read_json_file(file)) {
    only(json_, "",
         {"format", "version", "name", "frame", "clock", "robots", "communication_gaps", "provenance",
          "files"});
    if (text(json_, "", "format") != kFormat) fail("format", "must be \"" + std::string(kFormat) + "\"");
    const std::int64_t version = whole(json_, "", "version");
    if (version != kVersion) {
      fail("version",
           "is " + std::to_string(version) + ", this program reads version " + std::to_string(kVersion));
    }
  }

  [[nodiscard]] std::string text_or(const char* key, const std::string& otherwise) const {
    return json_.contains(key) ? text(json_, "", key) : otherwise;
  }

  [[nodiscard]] std::optional<Robots> robots() const {
    if (!json_.contains("robots")) return std::nullopt;
    std::vector<Robot> robots;
    for_each("robots", [&](const Json& item, const std::string& at) {
      only(item, at, {"name", "first", "last", "landmarks"});
      Robot robot{text(item, at, "name"), key(item, at, "first"), key(item, at, "last")};
      if (item.contains("landmarks")) {
        if (!item.at("landmarks").is_boolean()) fail(at + ".landmarks", "must be true or false");
        robot.landmarks = item.at("landmarks").get<bool>();
      }
      robots.push_back(std::move(robot));
    });
    try {
      return Robots(std::move(robots));
    } catch (const InputError& error) {
      fail("robots", error.what());
    }
  }

  [[nodiscard]] std::vector<CommunicationGap> gaps(const Robots& robots) const {
    std::vector<CommunicationGap> gaps;
    if (json_.contains("communication_gaps")) {
      for_each("communication_gaps", [&](const Json& item, const std::string& at) {
        only(item, at, {"robot", "begin_s", "end_s"});
        CommunicationGap gap;
        const std::string name = text(item, at, "robot");
        const auto robot = find_robot(robots, name);
        if (!robot) fail(at + ".robot", "\"" + name + "\" is not a robot of the mission");
        gap.robot = *robot;
        gap.begin_s = number(item, at, "begin_s");
        gap.end_s = number(item, at, "end_s");
        if (!(gap.begin_s < gap.end_s)) fail(at, "end_s must be after begin_s");
        gaps.push_back(gap);
      });
    }
    std::sort(gaps.begin(), gaps.end(), [](const CommunicationGap& a, const CommunicationGap& b) {
      return std::tie(a.robot, a.begin_s, a.end_s) < std::tie(b.robot, b.begin_s, b.end_s);
    });
    return gaps;
  }

  [[nodiscard]] std::optional<std::int64_t> start_ns() const {
    if (!json_.contains("clock")) return std::nullopt;
    const Json& clock = json_["clock"];
    only(clock, "clock", {"start_ns"});
    if (!clock.contains("start_ns")) return std::nullopt;
    const Json& value = clock["start_ns"];
    std::int64_t stamp = 0;
    const bool readable = value.is_string() ? text::parse_int64(value.get_ref<const std::string&>(), stamp)
                                            : value.is_number_integer();
    if (!readable) fail("clock.start_ns", "must be a stamp in ns");
    const bool too_large = value.is_number_unsigned() && value.get<std::uint64_t>() >> 63 != 0;
    if (!value.is_string()) stamp = value.get<std::int64_t>();
    if (too_large || !parts::stamp_in_range(stamp)) fail("clock.start_ns", "is out of range");
    return stamp;
  }

  [[nodiscard]] std::string provenance() const {
    if (!json_.contains("provenance")) return "{}";
    if (!json_["provenance"].is_object()) fail("provenance", "must be an object");
    return json_["provenance"].dump();
  }

  [[nodiscard]] Files files() const {
    Files files;
    if (!json_.contains("files")) return files;
    const Json& names = json_["files"];
    only(names, "files",
         {"graph", "stamps", "priors", "scans", "radio", "beacons", "ranges", "gravity", "odometry",
          "ground_truth", "reference"});
    const auto set = [&](const char* key, fs::path& file) {
      if (!names.contains(key)) return;
      const std::string name = text(names, "files", key);
      if (name.find('\0') != std::string::npos) fail("files." + std::string(key), "is not a file name");
      file = fs::path(name).lexically_normal();
      if (file.empty() || file.is_absolute() || *file.begin() == "..") {
        fail("files." + std::string(key), "\"" + file.string() + "\" is outside of the mission's folder");
      }
    };
    set("graph", files.graph);
    set("stamps", files.stamps);
    set("priors", files.priors);
    set("scans", files.scans);
    set("radio", files.radio);
    set("beacons", files.beacons);
    set("ranges", files.ranges);
    set("gravity", files.gravity);
    set("odometry", files.odometry);
    set("ground_truth", files.ground_truth);
    set("reference", files.reference);
    return files;
  }

  [[nodiscard]] static std::optional<std::size_t> find_robot(const Robots& robots, const std::string& name) {
    for (std::size_t r = 0; r < robots.size(); ++r) {
      if (robots[r].name == name) return r;
    }
    return std::nullopt;
  }

  [[noreturn]] void fail(const std::string& at, const std::string& why) const {
    throw InputError(file_ + ": " + at + ": " + why);
  }

 private:
  static std::string join(const std::string& at, const std::string& key) {
    return at.empty() ? key : at + "." + key;
  }

  void only(const Json& object, const std::string& at, const std::vector<std::string>& known) const {
    if (!object.is_object()) fail(at.empty() ? "the file" : at, "must be an object");
    for (const auto& item : object.items()) {
      if (std::find(known.begin(), known.end(), item.key()) != known.end()) continue;
      std::vector<std::string> full;
      full.reserve(known.size());
      for (const std::string& key : known) full.push_back(join(at, key));
      try {
        throw_unknown_name("key", join(at, item.key()), full);
      } catch (const OptionError& error) {
        throw InputError(file_ + ": " + error.what());
      }
    }
  }

  const Json& value(const Json& object, const std::string& at, const char* key) const {
    const auto found = object.find(key);
    if (found == object.end()) fail(join(at, key), "is missing");
    return *found;
  }

  std::string text(const Json& object, const std::string& at, const char* key) const {
    const Json& v = value(object, at, key);
    if (!v.is_string()) fail(join(at, key), "must be text in quotes");
    return v.get<std::string>();
  }

  std::int64_t whole(const Json& object, const std::string& at, const char* key) const {
    const Json& v = value(object, at, key);
    if (!v.is_number_integer() || (v.is_number_unsigned() && v.get<std::uint64_t>() >> 63 != 0)) {
      fail(join(at, key), "must be a 64-bit whole number");
    }
    return v.get<std::int64_t>();
  }

  double number(const Json& object, const std::string& at, const char* key) const {
    const Json& v = value(object, at, key);
    if (!v.is_number() || !std::isfinite(v.get<double>())) fail(join(at, key), "must be a number");
    return v.get<double>();
  }

  Key key(const Json& object, const std::string& at, const char* name) const {
    const Json& v = value(object, at, name);
    if (v.is_number_unsigned()) return v.get<Key>();
    if (!v.is_string()) fail(join(at, name), "must be a key: a number of 64 bits in quotes");
    try {
      return parse_key(v.get_ref<const std::string&>());
    } catch (const InputError& error) {
      fail(join(at, name), error.what());
    }
  }

  template <class Call>
  void for_each(const char* key, Call&& call) const {
    const Json& list = json_[key];
    if (!list.is_array()) fail(key, "must be a list");
    for (std::size_t i = 0; i < list.size(); ++i)
      call(list[i], std::string(key) + "[" + std::to_string(i) + "]");
  }

  std::string file_;
  const Json json_;
};

parts::Stamps read_stamps(const fs::path& file, const PoseGraph& graph, Problems& problems) {
  const CsvTable table(file, kStampColumns);
  parts::Stamps stamps;
  for (std::size_t row = 0; row < table.size(); ++row) {
    const Key key = table.key(row, 0);
    const std::int64_t stamp = table.integer(row, 1);
    if (!parts::stamp_in_range(stamp)) table.fail(row, 1, "stamp is out of range");
    if (!graph.contains(key)) {
      problems.add("stamp without node", file.string() + ":" + std::to_string(table.line(row)));
      continue;
    }
    if (!stamps.emplace(key, stamp).second) table.fail(row, 0, "node " + key_name(key) + " has two stamps");
  }
  for (const Node& node : graph.nodes()) {
    if (stamps.count(node.key) == 0)
      throw InputError(file.string() + ": no stamp for node " + std::to_string(node.key));
  }
  return stamps;
}

std::vector<PriorFactor> read_priors(const fs::path& file, const PoseGraph& graph, Problems& problems) {
  const CsvTable table(file, kPriorColumns);
  const std::string name = file.string();
  std::vector<PriorFactor> priors;
  for (std::size_t row = 0; row < table.size(); ++row) {
    PriorFactor prior;
    prior.key = table.key(row, 0);
    if (!graph.contains(prior.key))
      table.fail(row, 0, "node " + std::to_string(prior.key) + " is not in the graph");
    double values[13];
    for (std::size_t i = 0; i < 13; ++i) values[i] = table.number(row, i + 1);
    const text::Place place{name, table.line(row)};
    const text::Pose pose = text::pose_of(values, place);
    if (!pose.was_unit) problems.add_altered("non-unit quaternion", place.str());
    prior.pose = pose.pose;
    if (graph.planar() && !planar::is_pose(prior.pose))
      place.fail("the pose has z, roll or pitch, but the graph is 2D");
    for (std::size_t i = 7; i < 13; ++i) {
      // Beyond these bounds, the information overflows or vanishes.
      if (!(values[i] >= 1e-12 && values[i] <= 1e12))
        table.fail(row, i + 1, "a sigma must be in [1e-12, 1e12]");
    }
    prior.information = parts::information_of_sigmas(values + 7);
    priors.push_back(prior);
  }
  return priors;
}

std::vector<RadioReading> read_radio(const fs::path& file, const PoseGraph& graph, Problems& problems) {
  const CsvTable table(file, kRadioColumns);
  std::vector<RadioReading> readings;
  for (std::size_t row = 0; row < table.size(); ++row) {
    RadioReading reading{table.key(row, 0), table.text(row, 1), table.number_or_nan(row, 2),
                         table.text(row, 3), table.number_or_nan(row, 4)};
    if (reading.beacon.empty()) table.fail(row, 1, "is empty");
    if (!graph.contains(reading.key)) {
      problems.add("radio reading without node", file.string() + ":" + std::to_string(table.line(row)));
      continue;
    }
    readings.push_back(std::move(reading));
  }
  return readings;
}

std::vector<BeaconDrop> read_beacons(const fs::path& file, const PoseGraph& graph, const Robots& robots) {
  const CsvTable table(file, kBeaconColumns);
  std::vector<BeaconDrop> drops;
  std::set<std::string> names;
  for (std::size_t row = 0; row < table.size(); ++row) {
    BeaconDrop drop;
    drop.beacon = table.text(row, 0);
    if (drop.beacon.empty()) table.fail(row, 0, "is empty");
    if (!names.insert(drop.beacon).second) table.fail(row, 0, "beacon " + drop.beacon + " is dropped twice");
    const auto robot = FolderDescription::find_robot(robots, table.text(row, 1));
    if (!robot) table.fail(row, 1, text::quoted(table.text(row, 1)) + " is not a robot of the mission");
    drop.robot = *robot;
    drop.drop_key = table.key(row, 2);
    if (!graph.contains(drop.drop_key)) {
      table.fail(row, 2, "node " + std::to_string(drop.drop_key) + " is not in the graph");
    }
    drop.stamp_ns = table.integer(row, 3);
    if (!parts::stamp_in_range(drop.stamp_ns)) table.fail(row, 3, "stamp is out of range");
    drops.push_back(std::move(drop));
  }
  return drops;
}

std::optional<Key> key_of_name(const std::string& stem) {
  try {
    return parse_key(stem);
  } catch (const InputError&) {
    return std::nullopt;
  }
}

/// Reports graphs and tables in the folder that are no part of the mission: their names may be misspelt.
void report_unread(const fs::path& folder, const Files& files, Problems& problems) {
  const std::set<fs::path> parts{files.graph,        files.stamps,   files.priors,  files.radio,
                                 files.beacons,      files.ranges,   files.gravity, files.odometry,
                                 files.ground_truth, files.reference};
  std::set<fs::path> unread;
  std::error_code unreadable;  // a folder that cannot be listed may still be read
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, unreadable)) {
    const fs::path name = entry.path().filename();
    const bool is_table = name.extension() == ".g2o" || name.extension() == ".csv";
    if (is_table && parts.count(name) == 0) unread.insert(name);
  }
  for (const fs::path& name : unread) problems.add("file not read", (folder / name).string());
}

/// The six sigmas of a prior; empty if it has correlations or if a sigma cannot be written.
std::optional<Vector6d> sigmas_of(const Matrix6d& information) {
  const Vector6d diagonal = information.diagonal();
  if (information != Matrix6d(diagonal.asDiagonal())) return std::nullopt;
  const Vector6d sigmas = diagonal.cwiseSqrt().cwiseInverse();
  const bool writable = (sigmas.array() >= 1e-12).all() && (sigmas.array() <= 1e12).all();
  return writable ? std::optional<Vector6d>(sigmas) : std::nullopt;
}

}  // namespace

namespace parts {

Mission read_mission_folder(const fs::path& folder, const MissionOptions& options) {
  const FolderDescription description(folder / "mission.json");
  const Files files = description.files();
  const auto present = [&](const fs::path& file) {
    std::error_code unknown;  // parts::exists() reports it
    // Reading a pipe could block, and a device may never end.
    if (fs::is_other(folder / file, unknown)) throw InputError((folder / file).string() + ": is not a file");
    return parts::exists(folder / file);
  };

  Mission mission;
  mission.kind = MissionKind::kMission;
  mission.path = folder;
  mission.name = description.text_or("name", name_of(folder));
  mission.frame = description.text_or("frame", "map");
  mission.provenance_json = description.provenance();

  static_cast<void>(present(files.graph));
  G2oFile g2o = read_g2o(folder / files.graph);
  mission.problems = g2o.problems;
  report_unread(folder, files, mission.problems);
  if (present(files.ranges)) read_ranges(folder / files.ranges, g2o.graph);
  if (present(files.gravity)) read_gravity(folder / files.gravity, g2o.graph, mission.problems);
  const std::optional<Robots> listed = description.robots();
  mission.robots = robots_of(g2o.graph, options, listed ? *listed : Robots::from_keys(g2o.graph.keys()));

  Stamps stamps;
  if (present(files.stamps)) {
    stamps = read_stamps(folder / files.stamps, g2o.graph, mission.problems);
  } else {
    mission.problems.add("no stamps given", (folder / files.stamps).string());
    stamps = regular_stamps(g2o.graph, mission.robots, options);
  }
  std::vector<PriorFactor> priors = g2o.graph.priors();
  if (present(files.priors)) {
    const auto listed_priors = read_priors(folder / files.priors, g2o.graph, mission.problems);
    priors.insert(priors.end(), listed_priors.begin(), listed_priors.end());
  }
  if (priors.empty())
    complete_priors(g2o.graph, mission.robots, options, folder.string(), priors, mission.problems);
  MissionOptions own = options;
  if (own.odometry.empty() && present(files.odometry)) own.odometry = (folder / files.odometry).string();
  mission.graph =
      assemble(g2o.graph, stamps, priors, mission.robots, own, mission.problems, g2o.without_information);
  check_stamps(mission);
  if (const auto start = description.start_ns()) {
    if (*start > mission.start_ns) {
      description.fail("clock.start_ns",
                       std::to_string(*start) + " is after the first stamp, " +
                           std::to_string(mission.start_ns) +
                           (present(files.stamps) ? ""
                                                  : ": stamps begin at 0 without " + files.stamps.string() +
                                                        "; add that file, or leave out clock"));
    }
    mission.start_ns = *start;
  }
  mission.gaps = description.gaps(mission.robots);
  if (present(files.radio)) mission.radio = read_radio(folder / files.radio, mission.graph, mission.problems);
  if (present(files.beacons))
    mission.beacons = read_beacons(folder / files.beacons, mission.graph, mission.robots);
  if (present(files.ground_truth)) {
    set_ground_truth(mission, read_truth(folder / files.ground_truth, mission.problems));
  }
  if (present(files.reference)) {
    set_reference(mission, read_truth(folder / files.reference, mission.problems));
  }
  set_scans(mission, find_scans(folder / files.scans, key_of_name, mission.problems), options);
  return mission;
}

}  // namespace parts

MissionWriter::MissionWriter(fs::path folder, PcdEncoding encoding)
    : folder_(std::move(folder)), encoding_(encoding) {
  parts::require_empty(folder_);
  std::error_code error;
  fs::create_directories(folder_ / "scans", error);
  if (error) throw IoError(folder_.string(), error.message());
  write_file(folder_ / parts::kUnfinished, "This mission is being written, or its making was interrupted.\n");
}

void MissionWriter::add_scan(Key key, const PointCloud& cloud) const {
  write_file(folder_ / "scans" / (std::to_string(key) + ".pcd"), points::pcd_text(cloud, encoding_),
             Flush::kLater);
}

void MissionWriter::finish(const Mission& mission) const {
  const PoseGraph& graph = mission.graph;
  const Files files;
  for (const Node& node : graph.nodes()) static_cast<void>(mission.robots.of(node.key));
  const auto robot_name = [&](std::size_t robot) {
    if (robot >= mission.robots.size())
      throw InputError("robot " + std::to_string(robot) + " is not in the mission");
    return mission.robots[robot].name;
  };

  CsvText stamps(kStampColumns), priors(kPriorColumns);
  for (const Node& node : graph.nodes()) stamps.row(node.key, node.stamp_ns);
  std::vector<PriorFactor> correlated;
  for (const PriorFactor& prior : graph.priors()) {
    const auto sigmas = sigmas_of(prior.information);
    if (!sigmas) {
      correlated.push_back(prior);
      continue;
    }
    const Eigen::Vector3d t = prior.pose.translation();
    const Eigen::Quaterniond q(prior.pose.linear());
    const Vector6d& s = *sigmas;
    priors.row(prior.key, t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w(), s[0], s[1], s[2], s[3], s[4],
               s[5]);
  }
  const std::string ranges = parts::ranges_text(graph), gravity = parts::gravity_text(graph),
                    odometry = parts::odometry_list(graph, mission.robots).text;
  CsvText radio(kRadioColumns), beacons(kBeaconColumns);
  for (const RadioReading& r : mission.radio)
    radio.row(r.key, r.beacon, r.transmit_dbm, r.receiver, r.receive_dbm);
  for (const BeaconDrop& b : mission.beacons)
    beacons.row(b.beacon, robot_name(b.robot), b.drop_key, b.stamp_ns);

  Json json = Json::object();
  json["format"] = kFormat;
  json["version"] = kVersion;
  json["name"] = mission.name;
  json["frame"] = mission.frame;
  json["clock"] = {{"start_ns", std::to_string(mission.start_ns)}};
  json["robots"] = Json::array();
  for (const Robot& robot : mission.robots.all()) {
    Json& item = json["robots"].emplace_back();
    item = {
        {"name", robot.name}, {"first", std::to_string(robot.first)}, {"last", std::to_string(robot.last)}};
    if (robot.landmarks) item["landmarks"] = true;
  }
  json["communication_gaps"] = Json::array();
  for (const CommunicationGap& gap : mission.gaps) {
    json["communication_gaps"].push_back(
        {{"robot", robot_name(gap.robot)}, {"begin_s", gap.begin_s}, {"end_s", gap.end_s}});
  }
  json["provenance"] = parse_json(mission.provenance_json, "provenance");
  if (!json["provenance"].is_object()) throw InputError("provenance is not a JSON object");

  write_file(folder_ / files.graph, g2o_text(graph, correlated));
  write_file(folder_ / files.stamps, stamps.text());
  write_file(folder_ / files.priors, priors.text());
  if (!graph.ranges().empty()) write_file(folder_ / files.ranges, ranges);
  if (!graph.gravities().empty()) write_file(folder_ / files.gravity, gravity);
  if (!odometry.empty()) write_file(folder_ / files.odometry, odometry);
  if (!mission.radio.empty()) write_file(folder_ / files.radio, radio.text());
  if (!mission.beacons.empty()) write_file(folder_ / files.beacons, beacons.text());
  const auto write_poses = [this](const fs::path& file, const std::map<Key, Eigen::Isometry3d>& poses) {
    if (poses.empty()) return;
    PoseGraph vertices;
    for (const auto& [key, pose] : poses) {
      Node node;
      node.key = key;
      node.pose = pose;
      vertices.add_node(node);
    }
    write_g2o(folder_ / file, vertices);
  };
  write_poses(files.ground_truth, mission.ground_truth);
  write_poses(files.reference, mission.reference);
  flush_file_system(folder_);  // scans first, because mission.json marks the mission as complete
  write_file(folder_ / "mission.json", json_text(json, 2) + "\n");
  std::error_code ignored;  // the mark has no effect beside mission.json
  fs::remove(folder_ / parts::kUnfinished, ignored);
}

void write_mission(const fs::path& folder, const Mission& mission, PcdEncoding encoding) {
  const MissionWriter writer(folder, encoding);
  for (const Key key : mission.scans->keys()) writer.add_scan(key, *mission.scans->load(key));
  writer.finish(mission);
}

}  // namespace loopwise
