// SPDX-License-Identifier: BSD-3-Clause
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <set>

#include <loopwise/core/error.hpp>

#include "bag.hpp"
#include "bag_check.hpp"
#include "cloud_files.hpp"
#include "file_kind.hpp"
#include "lamp_messages.hpp"
#include "point_cloud2.hpp"
#include "zip_archive.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;
using bags::BagFile;
using bags::BagSet;
using lamp::MessageKind;

/// The definitions of a recording's connections, each read when its first message comes.
class Schemas {
 public:
  explicit Schemas(const std::vector<bags::Connection>& connections)
      : connections_(&connections), schemas_(connections.size()) {}

  const std::shared_ptr<const ros1::Schema>& of(std::size_t connection) {
    auto& schema = schemas_[connection];
    const bags::Connection& c = (*connections_)[connection];
    if (!schema) schema = std::make_shared<const ros1::Schema>(c.type, c.definition);
    return schema;
  }

 private:
  const std::vector<bags::Connection>* connections_;
  std::vector<std::shared_ptr<const ros1::Schema>> schemas_;
};

/// Hands out the scans that an index pass has found.
class BagScans {
 public:
  BagScans(BagSet bags, std::vector<fs::path> files) : bags_(std::move(bags)), files_(std::move(files)) {}

  void add(Key key, std::size_t number, const bags::Connection& connection,
           const std::shared_ptr<const ros1::Schema>& schema) {
    scans_[key] = {number, files_[connection.bag].string(), schema};
  }
  [[nodiscard]] bool has(Key key) const { return scans_.count(key) != 0; }
  [[nodiscard]] std::vector<Key> keys() const {
    std::vector<Key> keys;
    for (const auto& [key, scan] : scans_) keys.push_back(key);
    return keys;
  }
  [[nodiscard]] std::string where(Key key) const { return scans_.at(key).bag + ": scan " + key_name(key); }
  [[nodiscard]] CloudFile read(Key key) const {
    const Scan& scan = scans_.at(key);
    const BagSet::Kept kept = bags_.fetch(scan.number);
    return ros1::read_point_cloud2(where(key), ros1::Value(*scan.schema, kept.bytes).at("scan"));
  }

 private:
  struct Scan {
    std::size_t number = 0;
    std::string bag;
    std::shared_ptr<const ros1::Schema> schema;
  };
  BagSet bags_;
  std::vector<fs::path> files_;
  std::map<Key, Scan> scans_;
};

bool is_lamp(MessageKind kind) {
  return kind != MessageKind::kOther && kind != MessageKind::kOdometry;
}

std::vector<BagFile> bag_files(const std::vector<fs::path>& paths) {
  std::vector<BagFile> files;
  files.reserve(paths.size());
  for (const fs::path& path : paths) files.push_back({path, path.string()});
  return files;
}

/// The bags of a recording: its own, then those of its truth.
struct Recording {
  std::vector<fs::path> files;
  std::size_t own = 0;  // how many are its own
  fs::path truth;       // a g2o file, if the truth is one
};

Recording recording_of(const std::vector<fs::path>& paths, Problems& problems) {
  Recording recording;
  std::set<fs::path> seen;  // one that is given by name and found beside as well is read once
  const auto add = [&](const fs::path& file) {
    refuse_foreign_file(file, {FileKind::kBag}, "a ROS 1 bag");
    if (seen.insert(fs::weakly_canonical(file)).second) recording.files.push_back(file);
  };
  parts::TruthFiles truth;
  for (const fs::path& path : paths) {
    const bool folder = fs::is_directory(path);
    if (truth.g2o.empty() && truth.bags.empty()) {
      truth = parts::find_truth(folder ? path : fs::absolute(path).parent_path());
    }
    if (!folder) {
      add(path);
      continue;
    }
    const std::size_t before = recording.files.size();
    for (const fs::path& entry : parts::entries(path)) {
      if (!fs::is_regular_file(entry)) continue;
      if (entry.extension() == ".bag") add(entry);
      if (entry.extension() == ".active")
        problems.add_altered("bag that was never closed left out", entry.string());
    }
    if (recording.files.size() == before) throw InputError(path.string() + ": no bag in it");
  }
  recording.own = recording.files.size();
  recording.truth = truth.g2o;
  for (const fs::path& file : truth.bags) add(file);
  return recording;
}

/// Hands a message other than a scan to the gatherer.
void take(lamp::Gatherer& gatherer, const std::string& where, const bags::Connection& connection,
          const fs::path& bag, const ros1::Value& message, std::int64_t recorded_ns) {
  switch (lamp::message_kind(connection.type)) {
    case MessageKind::kPoseGraph:
      gatherer.add_graph(where, connection.topic, recorded_ns, message);
      break;
    case MessageKind::kBeacons:
      gatherer.add_beacons(message, recorded_ns);
      break;
    case MessageKind::kRadio:
      gatherer.add_radio(message, recorded_ns);
      break;
    case MessageKind::kOdometry:
      gatherer.add_truth({connection.topic, bag.filename().string()}, message, recorded_ns);
      break;
    case MessageKind::kKeyedScan:
    case MessageKind::kOther:
      break;
  }
}

/// A temporary copy under a name of our own.
class TemporaryFile {
 public:
  TemporaryFile() {
    std::string pattern = (fs::temp_directory_path() / "loopwise-XXXXXX").string();
    const int fd = ::mkstemp(pattern.data());
    if (fd < 0) throw IoError(pattern, std::strerror(errno));
    ::close(fd);
    path_ = pattern;
  }
  ~TemporaryFile() {
    std::error_code ignored;
    fs::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  [[nodiscard]] const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

}  // namespace

namespace parts {

Mission read_bags(const std::vector<fs::path>& paths, const MissionOptions& options, const Work& work) {
  Mission mission;
  mission.kind = MissionKind::kBags;
  mission.path = paths.front();
  mission.name = recording_name(paths.front()) +
                 (paths.size() > 1 ? "+" + std::to_string(paths.size() - 1) : std::string());
  Problems& problems = mission.problems;
  const Recording recording = recording_of(paths, problems);
  BagSet bags(bag_files(recording.files), problems, work.progress, work.stop);
  const std::vector<bags::Connection>& connections = bags.connections();
  std::set<std::size_t> with_lamp;  // bags whose odometry is the robot's own
  for (const bags::Connection& connection : connections) {
    if (is_lamp(lamp::message_kind(connection.type)) && connection.bag < recording.own) {
      with_lamp.insert(connection.bag);
    }
  }

  lamp::Gatherer gatherer(options, problems);
  Schemas schemas(connections);
  const auto scans = std::make_shared<BagScans>(bags, recording.files);
  std::size_t kept = 0;
  /// Whether the scan is to be found again.
  const auto take_scan = [&](const std::string& where, std::size_t connection, const ros1::Value& message) {
    const Key key = message.at("key").unsigned_integer();
    if (scans->has(key)) {
      problems.add("repeated scan", where + ": " + key_name(key));
      return false;
    }
    ros1::check_point_cloud2("scan " + key_name(key), message.at("scan"));
    scans->add(key, kept++, connections[connection], schemas.of(connection));
    return true;
  };
  bags.for_each(
      [&](const bags::Connection& connection) {
        const MessageKind kind = lamp::message_kind(connection.type);
        if (kind != MessageKind::kOdometry) return is_lamp(kind) && connection.bag < recording.own;
        const bool is_truth = with_lamp.count(connection.bag) == 0;
        if (!is_truth) {
          problems.add("odometry messages not used",
                       recording.files[connection.bag].string() + ": " + connection.topic);
        }
        return is_truth;
      },
      [&](const bags::Message& message) {
        const bags::Connection& connection = connections[message.connection];
        const fs::path& bag = recording.files[connection.bag];
        const std::string where = bag.string() + ": " + connection.topic;
        try {
          const ros1::Value value(*schemas.of(message.connection), message.bytes);
          if (lamp::message_kind(connection.type) == MessageKind::kKeyedScan) {
            return take_scan(where, message.connection, value);
          }
          take(gatherer, where, connection, bag, value, message.stamp_ns);
        } catch (const InputError& error) {
          problems.add_altered("message cannot be read", where + ": " + error.what());
        }
        return false;
      },
      work.progress, work.stop);

  gatherer.finish(mission, mission.path.string());
  if (!recording.truth.empty() && mission.ground_truth.empty()) {
    set_ground_truth(mission, read_truth(recording.truth, problems));
  }
  set_scans(
      mission, scans->keys(), [scans](Key key) { return scans->read(key); },
      [&](Key key) { return scans->where(key); }, options);
  std::vector<std::string> sources;
  for (std::size_t i = 0; i < recording.own; ++i) {
    sources.push_back(recording.files[i].filename().string());
  }
  mission.provenance_json = provenance_of(mission.kind, sources);
  return mission;
}

void read_bag_truth(Mission& mission, const std::vector<fs::path>& files, const MissionOptions& options,
                    const Work& work) {
  if (!bags::available()) {
    mission.problems.add("ground truth not read", files.front().string() + ": " + bags::kUnavailable);
    return;
  }
  BagSet bags(bag_files(files), mission.problems, work.progress, work.stop);
  const std::vector<bags::Connection>& connections = bags.connections();
  lamp::Gatherer gatherer(options, mission.problems);
  Schemas schemas(connections);
  bags.for_each(
      [](const bags::Connection& connection) {
        return lamp::message_kind(connection.type) == MessageKind::kOdometry;
      },
      [&](const bags::Message& message) {
        const bags::Connection& connection = connections[message.connection];
        const fs::path& bag = files[connection.bag];
        const std::string where = bag.string() + ": " + connection.topic;
        try {
          take(gatherer, where, connection, bag, ros1::Value(*schemas.of(message.connection), message.bytes),
               message.stamp_ns);
        } catch (const InputError& error) {
          mission.problems.add_altered("message cannot be read", where + ": " + error.what());
        }
        return false;
      },
      work.progress, work.stop);
  gatherer.add_truth_to(mission);
}

void unpack(const ZipArchive& archive, std::size_t number, const fs::path& to, const std::string& name,
            const StopToken& stop) {
  // A small archive may claim any size, and a deflated one may even have it.
  const std::uint64_t free = fs::space(to.parent_path()).available;
  if (archive.size(number) > free) {
    throw InputError(name + ": unpacked it takes " + std::to_string(archive.size(number)) +
                     " bytes, of which " + to.parent_path().string() + " has " + std::to_string(free));
  }
  std::ofstream out(to, std::ios::binary);
  archive.read(number, [&](std::string_view piece) {
    if (stop.stop_requested()) throw StoppedError("unpacking " + name + " was stopped");
    out.write(piece.data(), static_cast<std::streamsize>(piece.size()));
    if (!out) throw IoError(to.string(), "cannot be written");
  });
  out.close();
  if (!out) throw IoError(to.string(), "cannot be written");
}

Mission read_lamp_save(const fs::path& path, const MissionOptions& options, const Work& work) {
  const bool folder = fs::is_directory(path);
  const FileSource files = folder ? files_of_folder(path) : files_of_archive(path);
  const auto graph = files.find("pose_graph.bag"), table_file = files.find("keys.csv");
  if (!graph) {
    throw InputError(
        path.string() +
        ": no pose_graph.bag in it: not a map that LAMP saved. Clouds of a g2o_pcd folder are read "
        "with their folder");
  }
  Mission mission;
  mission.kind = MissionKind::kLampZip;
  mission.path = path;
  mission.name = recording_name(path);
  Problems& problems = mission.problems;
  const KeyTable table =
      table_file ? parse_key_table(files.path(*table_file), files.read(*table_file)) : KeyTable();

  std::unique_ptr<TemporaryFile> copy;
  fs::path bag_path = path / "pose_graph.bag";
  if (!folder) {
    copy = std::make_unique<TemporaryFile>();
    bag_path = copy->path();
    unpack(ZipArchive(path), *graph, bag_path, files.path(*graph), work.stop);
  }
  BagSet bags({{bag_path, files.path(*graph)}}, problems, work.progress, work.stop);
  const std::vector<bags::Connection>& connections = bags.connections();
  // The whole graph each time: the last is the one that LAMP itself takes.
  const std::size_t count = bags.for_each(
      [](const bags::Connection& connection) {
        return lamp::message_kind(connection.type) == MessageKind::kPoseGraph;
      },
      [](const bags::Message&) { return true; }, work.progress, work.stop);
  if (count == 0) throw InputError(files.path(*graph) + ": no pose_graph_msgs/PoseGraph in it");
  const BagSet::Kept last = bags.fetch(count - 1);
  const ros1::Schema schema(connections[last.connection].type, connections[last.connection].definition);
  lamp::Gatherer gatherer(options, problems);
  try {
    gatherer.add_graph(files.path(*graph), "", 0, ros1::Value(schema, last.bytes));
  } catch (const InputError& error) {
    throw InputError(files.path(*graph) + ": " + error.what());
  }
  gatherer.use_stamps(table.stamps);
  gatherer.finish(mission, path.string());

  const TruthFiles truth = find_truth(folder ? path : fs::absolute(path).parent_path());
  if (!truth.g2o.empty()) {
    set_ground_truth(mission, read_truth(truth.g2o, problems));
  } else if (!truth.bags.empty()) {
    read_bag_truth(mission, truth.bags, options, work);
  }
  const NamedClouds clouds = name_clouds(files, table, problems);
  set_scans(mission, files, clouds_of_nodes(clouds, key_frames(mission.graph, mission.robots), files),
            options);
  mission.provenance_json = provenance_of(mission.kind, {path.filename().string()});
  return mission;
}

}  // namespace parts
}  // namespace loopwise
