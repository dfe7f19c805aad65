// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <fstream>
#include <map>
#include <memory>
#include <set>

#include <loopwise/core/error.hpp>

#include "bag.hpp"
#include "bag_recording.hpp"
#include "cloud_files.hpp"
#include "lamp_messages.hpp"
#include "point_cloud2.hpp"
#include "temporary_file.hpp"
#include "zip_archive.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;
using bags::BagSet;
using lamp::MessageKind;

/// Reads the scans that an earlier pass has found.
class BagScans {
 public:
  BagScans(BagSet bags, std::vector<fs::path> files) : bags_(std::move(bags)), files_(std::move(files)) {}

  void add(Key key, std::size_t number, const bags::Connection& connection) {
    scans_[key] = {number, files_[connection.bag].string()};
  }
  [[nodiscard]] bool has(Key key) const { return scans_.count(key) != 0; }
  [[nodiscard]] std::vector<Key> keys() const {
    std::vector<Key> keys;
    for (const auto& [key, scan] : scans_) keys.push_back(key);
    return keys;
  }
  [[nodiscard]] std::string where(Key key) const { return scans_.at(key).bag + ": scan " + key_name(key); }
  [[nodiscard]] CloudFile read(Key key) const {
    const BagSet::Kept kept = bags_.fetch(scans_.at(key).number);
    bags::Decoder decoder({bags_.connections()[kept.connection]});
    return ros1::read_point_cloud2(where(key), decoder.message(0, kept.bytes).at("scan"));
  }

 private:
  struct Scan {
    std::size_t number = 0;
    std::string bag;
  };
  BagSet bags_;
  std::vector<fs::path> files_;
  std::map<Key, Scan> scans_;
};

bool is_lamp(MessageKind kind) {
  return kind != MessageKind::kOther && kind != MessageKind::kOdometry;
}

/// Passes a message other than a scan to the gatherer.
void add_message(lamp::Gatherer& gatherer, const std::string& where, const bags::Connection& connection,
                 const std::string& source, const ros1::Value& message, std::int64_t recorded_ns) {
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
      gatherer.add_truth({connection.topic, source}, message, recorded_ns);
      break;
    case MessageKind::kKeyedScan:
    case MessageKind::kOther:
      break;
  }
}

/// How a message of LAMP's is used.
const char* use_of(MessageKind kind) {
  switch (kind) {
    case MessageKind::kKeyedScan:
      return "scans of nodes";
    case MessageKind::kPoseGraph:
      return "nodes and factors";
    case MessageKind::kBeacons:
      return "beacons";
    case MessageKind::kRadio:
      return "received powers";
    case MessageKind::kOdometry:
      return "true poses";
    case MessageKind::kOther:
      break;
  }
  return "";
}

/// The used connections with their use. Odometry is the truth, unless its recorder has messages of LAMP's:
/// then it is the robot's own and not used. Each bag of ROS 1 counts as a recorder.
std::map<std::size_t, std::string> uses_of(const std::vector<bags::Connection>& connections,
                                           const bags::Recording& recording, const bags::Decoder& decoder,
                                           Problems& problems) {
  const auto recorder_of = [&](std::size_t bag) {
    const bool alone = recording.files[bag].extension() == ".bag";
    return alone ? recording.names.size() + bag : recording.recorders[bag];
  };
  std::set<std::size_t> with_lamp;
  for (const bags::Connection& connection : connections) {
    if (is_lamp(lamp::message_kind(connection.type)) && connection.bag < recording.own)
      with_lamp.insert(recorder_of(connection.bag));
  }
  std::map<std::size_t, std::string> uses;
  for (std::size_t i = 0; i < connections.size(); ++i) {
    const bags::Connection& connection = connections[i];
    const MessageKind kind = lamp::message_kind(connection.type);
    const std::string bag = recording.files[connection.bag].string();
    const bool is_own = connection.bag < recording.own;
    if (kind == MessageKind::kOther || (is_lamp(kind) && !is_own)) continue;
    if (kind == MessageKind::kOdometry && with_lamp.count(recorder_of(connection.bag)) != 0) {
      problems.add("odometry messages not used", bag + ": " + connection.topic);
    } else if (decoder.can_read(i, bag, problems)) {
      uses[i] = use_of(kind);
    }
  }
  return uses;
}

/// Whether the recording contains graphs of LAMP's. Without them, key frames are made from it.
bool has_graphs(const std::vector<bags::Connection>& connections, const bags::Recording& recording) {
  return std::any_of(connections.begin(), connections.end(), [&](const bags::Connection& connection) {
    return is_lamp(lamp::message_kind(connection.type)) && connection.bag < recording.own;
  });
}

/// Reads a mission from graphs and keyed scans.
Mission read_graphs(const BagSet& bags, const bags::Recording& recording, const MissionOptions& options,
                    const parts::Work& work) {
  Mission mission;
  Problems& problems = mission.problems;
  const std::vector<bags::Connection>& connections = bags.connections();
  lamp::Gatherer gatherer(options, problems);
  bags::Decoder decoder(connections);
  const auto uses = uses_of(connections, recording, decoder, problems);
  const auto scans = std::make_shared<BagScans>(bags, recording.files);
  std::size_t kept = 0;
  /// Returns whether the scan has to be fetched later.
  const auto add_scan = [&](const std::string& where, std::size_t connection, const ros1::Value& message) {
    const Key key = message.at("key").unsigned_integer();
    if (scans->has(key)) {
      problems.add("repeated scan", where + ": " + key_name(key));
      return false;
    }
    ros1::check_point_cloud2("scan " + key_name(key), message.at("scan"));
    scans->add(key, kept++, connections[connection]);
    return true;
  };
  BagSet(bags).for_each([&](std::size_t connection) { return uses.count(connection) != 0; },
                        [&](const bags::Message& message) {
                          const bags::Connection& connection = connections[message.connection];
                          const fs::path& bag = recording.files[connection.bag];
                          const std::string where = bag.string() + ": " + connection.topic;
                          try {
                            const ros1::Value value = decoder.message(message.connection, message.bytes);
                            if (lamp::message_kind(connection.type) == MessageKind::kKeyedScan) {
                              return add_scan(where, message.connection, value);
                            }
                            add_message(gatherer, where, connection, bag.filename().string(), value,
                                        message.stamp_ns);
                          } catch (const InputError& error) {
                            problems.add_altered("message cannot be read", where + ": " + error.what());
                          }
                          return false;
                        },
                        work.progress, work.stop);

  gatherer.finish(mission, recording.files.front().string());
  if (!recording.truth.empty() && mission.ground_truth.empty()) {
    parts::set_ground_truth(mission, parts::read_truth(recording.truth, problems));
  }
  parts::set_scans(
      mission, scans->keys(), [scans](Key key) { return scans->read(key); },
      [&](Key key) { return scans->where(key); }, options);
  mission.topics = bags::recorded_topics(connections, uses);
  return mission;
}

}  // namespace

namespace parts {

Mission read_bags(const std::vector<fs::path>& paths, const MissionOptions& options, const Work& work) {
  Problems problems;
  const bags::Recording recording = bags::recording_of(paths, problems);
  const BagSet bags(bags::bag_files(recording.files), bags::is_known_type, problems, work.progress,
                    work.stop);
  Mission mission = has_graphs(bags.connections(), recording)
                        ? read_graphs(bags, recording, options, work)
                        : bags::read_key_frames(bags, recording, options, work);
  problems.add(mission.problems);
  mission.problems = std::move(problems);
  mission.kind = MissionKind::kBags;
  mission.path = paths.front();
  mission.name = recording_name(paths.front()) +
                 (paths.size() > 1 ? "+" + std::to_string(paths.size() - 1) : std::string());
  std::vector<std::string> sources;
  for (std::size_t i = 0; i < recording.own; ++i) {
    sources.push_back(recording.files[i].filename().string());
  }
  mission.provenance_json = provenance_of(mission.kind, sources);
  return mission;
}

void read_bag_truth(Mission& mission, const std::vector<fs::path>& files, const MissionOptions& options,
                    const Work& work) {
  const bool can_read = std::all_of(files.begin(), files.end(), [](const fs::path& file) {
    return file.extension() == ".bag" ? bags::available() : bags::rosbag2_available();
  });
  if (!can_read) {
    mission.problems.add(
        "ground truth not read",
        files.front().string() + ": " + (bags::available() ? bags::kRosbag2Unavailable : bags::kUnavailable));
    return;
  }
  BagSet bags(bags::bag_files(files), bags::is_known_type, mission.problems, work.progress, work.stop);
  const std::vector<bags::Connection>& connections = bags.connections();
  lamp::Gatherer gatherer(options, mission.problems);
  bags::Decoder decoder(connections);
  bags.for_each(
      [&](std::size_t i) {
        return lamp::message_kind(connections[i].type) == MessageKind::kOdometry &&
               decoder.can_read(i, files[connections[i].bag].string(), mission.problems);
      },
      [&](const bags::Message& message) {
        const bags::Connection& connection = connections[message.connection];
        const fs::path& bag = files[connection.bag];
        const std::string where = bag.string() + ": " + connection.topic;
        try {
          add_message(gatherer, where, connection, bag.filename().string(),
                      decoder.message(message.connection, message.bytes), message.stamp_ns);
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
  // A small archive may state any size, and may really expand to it.
  const std::uint64_t free = fs::space(to.parent_path()).available;
  if (archive.size(number) > free) {
    throw InputError(name + ": the unpacked file needs " + std::to_string(archive.size(number)) +
                     " bytes, but " + to.parent_path().string() + " has only " + std::to_string(free) +
                     ": set TMPDIR to a larger disk");
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
        ": has no pose_graph.bag, so it is not a map saved by LAMP. To read the clouds of a g2o_pcd "
        "folder, give the folder");
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
  BagSet bags({{bag_path, files.path(*graph)}}, bags::is_known_type, problems, work.progress, work.stop);
  const std::vector<bags::Connection>& connections = bags.connections();
  // Each message has the whole graph. The last one is used, as LAMP does.
  const std::size_t count = bags.for_each(
      [&](std::size_t i) { return lamp::message_kind(connections[i].type) == MessageKind::kPoseGraph; },
      [](const bags::Message&) { return true; }, work.progress, work.stop);
  if (count == 0) throw InputError(files.path(*graph) + ": no pose_graph_msgs/PoseGraph in it");
  const BagSet::Kept last = bags.fetch(count - 1);
  bags::Decoder decoder({connections[last.connection]});
  lamp::Gatherer gatherer(options, problems);
  try {
    gatherer.add_graph(files.path(*graph), "", 0, decoder.message(0, last.bytes));
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
