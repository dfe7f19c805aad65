// SPDX-License-Identifier: BSD-3-Clause
#include "bag_recording.hpp"

#include <algorithm>
#include <set>
#include <tuple>
#include <utility>

#include <loopwise/core/error.hpp>

#include "bag_files.hpp"
#include "bag_streams.hpp"
#include "cdr.hpp"
#include "file_kind.hpp"
#include "lamp_messages.hpp"

namespace loopwise::bags {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostNamed = 20;  // topics in an error

/// Collects files, each once. A file that is given by name may also be found in a folder.
class Collector {
 public:
  explicit Collector(Recording& recording) : recording_(recording) {}

  void add(const fs::path& file, const std::string& recorder) {
    refuse_foreign_file(file, {FileKind::kBag, FileKind::kSqlite, FileKind::kMcap, FileKind::kCompressed},
                        "a bag of ROS 1 or 2");
    if (!seen_.insert(fs::weakly_canonical(file)).second) return;
    recording_.files.push_back(file);
    const auto known = numbers_.emplace(file.parent_path(), recording_.names.size());
    if (known.second) recording_.names.push_back(recorder);
    recording_.recorders.push_back(known.first->second);
  }

 private:
  Recording& recording_;
  std::set<fs::path> seen_;
  std::map<fs::path, std::size_t> numbers_;  // of folders
};

}  // namespace

std::vector<BagFile> bag_files(const std::vector<fs::path>& paths) {
  std::vector<BagFile> files;
  files.reserve(paths.size());
  for (const fs::path& path : paths) files.push_back({path, path.string()});
  return files;
}

Recording recording_of(const std::vector<fs::path>& paths, Problems& problems) {
  Recording recording;
  Collector collector(recording);
  parts::TruthFiles truth;
  for (const fs::path& path : paths) {
    const bool folder = fs::is_directory(path);
    if (truth.g2o.empty() && truth.bags.empty()) {
      truth = parts::find_truth(folder ? path : fs::absolute(path).parent_path());
    }
    if (!folder) {
      collector.add(path, parts::recording_name(path));
      continue;
    }
    const std::size_t before = recording.files.size();
    for (const Parts& files : bags_of_folder(path, problems)) {
      for (const fs::path& file : files) collector.add(file, parts::recording_name(file.parent_path()));
    }
    if (recording.files.size() == before) throw InputError(path.string() + ": no bag in it");
  }
  recording.own = recording.files.size();
  recording.truth = truth.g2o;
  for (const fs::path& file : truth.bags) collector.add(file, parts::recording_name(file));
  return recording;
}

bool is_known_type(const std::string& type) {
  return lamp::message_kind(type) != lamp::MessageKind::kOther || stream_kind(type) != StreamKind::kOther;
}

Decoder::Decoder(std::vector<Connection> connections)
    : connections_(std::move(connections)), schemas_(connections_.size()) {}

const ros1::Schema& Decoder::schema(std::size_t number) {
  auto& schema = schemas_[number];
  const Connection& connection = connections_[number];
  if (!schema) schema = std::make_unique<const ros1::Schema>(connection.type, connection.definition);
  return *schema;
}

bool Decoder::can_read(std::size_t number, const std::string& bag, Problems& problems) const {
  const Connection& c = connections_[number];
  const std::string where = bag + ": " + c.topic + ", " + c.type;
  if (c.encoding == Encoding::kOther) {
    problems.add_altered("topic of unknown encoding left out",
                         where + ", encoding \"" + c.encoding_name + "\", expected cdr or ros1");
    return false;
  }
  if (c.definition.empty()) {
    problems.add_altered("topic without message definition left out",
                         where + ": the bag has no definition of it, and the type is not known without");
    return false;
  }
  return true;
}

ros1::Value Decoder::message(std::size_t number, std::string_view bytes) {
  if (connections_[number].encoding == Encoding::kRos1) return {schema(number), bytes};
  buffer_ = cdr::to_ros1(schema(number), bytes);
  return {schema(number), buffer_};
}

std::vector<RecordedTopic> recorded_topics(const std::vector<Connection>& connections,
                                           const std::map<std::size_t, std::string>& uses) {
  std::map<std::tuple<std::string, std::string, std::string>, std::size_t> topics;
  for (std::size_t i = 0; i < connections.size(); ++i) {
    const auto use = uses.find(i);
    topics[{connections[i].topic, connections[i].type, use == uses.end() ? "" : use->second}] +=
        connections[i].messages;
  }
  std::vector<RecordedTopic> out;
  for (const auto& [topic, messages] : topics)
    out.push_back({std::get<0>(topic), std::get<1>(topic), messages, std::get<2>(topic)});
  return out;
}

std::string topics_text(const std::vector<Connection>& connections) {
  const std::vector<RecordedTopic> topics = recorded_topics(connections, {});
  if (topics.empty()) return "no topic";
  std::string out;
  for (std::size_t i = 0; i < std::min(topics.size(), kMostNamed); ++i) {
    out += (i > 0 ? ", " : "") + topics[i].name + " (" + topics[i].type + ", " +
           std::to_string(topics[i].messages) + " messages)";
  }
  return topics.size() > kMostNamed ? out + " and " + std::to_string(topics.size() - kMostNamed) + " more"
                                    : out;
}

}  // namespace loopwise::bags
