// SPDX-License-Identifier: BSD-3-Clause
#include <cstring>
#include <map>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/evaluation/run_folder.hpp>
#include <loopwise/evaluation/run_mcap.hpp>

#include "replay/testing_mission.hpp"
#include "testing.hpp"

namespace loopwise::run_mcap_test {
namespace {

using Catch::Matchers::Contains;

/// Reads numbers and strings of MCAP and of CDR from a text.
class Bytes {
 public:
  explicit Bytes(std::string text) : text_(std::move(text)) {}
  template <class T>
  T number() {
    T value{};
    REQUIRE(at_ + sizeof(T) <= text_.size());
    std::memcpy(&value, text_.data() + at_, sizeof(T));
    at_ += sizeof(T);
    return value;
  }
  std::string take(std::size_t count) {
    REQUIRE(at_ + count <= text_.size());
    at_ += count;
    return text_.substr(at_ - count, count);
  }
  std::string string() { return take(number<std::uint32_t>()); }
  std::string rest() { return take(text_.size() - at_); }
  [[nodiscard]] bool end() const { return at_ == text_.size(); }
  [[nodiscard]] std::size_t at() const { return at_; }
  void align(std::size_t size) {
    while (at_ % size != 0) ++at_;
  }

 private:
  std::string text_;
  std::size_t at_ = 0;
};

struct Message {
  std::string topic;
  std::uint64_t time_ns;
  std::string data;
};

struct File {
  std::map<std::uint16_t, std::string> schemas;  // by id: the name
  std::map<std::string, std::string> types;      // by topic
  std::vector<Message> messages;
  std::uint64_t counted = 0;  // by the statistics
  std::size_t chunks = 0, indexed_chunks = 0;
};

/// Reads the records of a file or a chunk in their order.
void read_records(Bytes bytes, std::size_t until, File& file, std::map<std::uint16_t, std::string>& topics) {
  while (bytes.at() < until) {
    const auto opcode = bytes.number<std::uint8_t>();
    const std::string content = bytes.take(bytes.number<std::uint64_t>());
    Bytes record(content);
    if (opcode == 0x03) {
      const auto id = record.number<std::uint16_t>();
      file.schemas[id] = record.string();
      REQUIRE(record.string() == "ros2msg");
    } else if (opcode == 0x04) {
      const auto id = record.number<std::uint16_t>();
      const auto schema = record.number<std::uint16_t>();
      topics[id] = record.string();
      REQUIRE(file.schemas.count(schema) == 1);
      file.types[topics[id]] = file.schemas[schema];
      REQUIRE(record.string() == "cdr");
    } else if (opcode == 0x05) {
      const auto id = record.number<std::uint16_t>();
      record.number<std::uint32_t>();
      const auto time_ns = record.number<std::uint64_t>();
      record.number<std::uint64_t>();
      REQUIRE(topics.count(id) == 1);
      file.messages.push_back({topics[id], time_ns, record.rest()});
    } else if (opcode == 0x06) {
      ++file.chunks;
      const auto begin = record.number<std::uint64_t>(), end = record.number<std::uint64_t>();
      const auto size = record.number<std::uint64_t>();
      record.number<std::uint32_t>();
      REQUIRE(record.string().empty());
      const std::string records = record.take(record.number<std::uint64_t>());
      REQUIRE(records.size() == size);
      const std::size_t before = file.messages.size();
      read_records(Bytes(records), records.size(), file, topics);
      for (std::size_t i = before; i < file.messages.size(); ++i) {
        REQUIRE(file.messages[i].time_ns >= begin);
        REQUIRE(file.messages[i].time_ns <= end);
      }
    } else if (opcode == 0x08) {
      ++file.indexed_chunks;
    } else if (opcode == 0x0B) {
      file.counted = record.number<std::uint64_t>();
    }
  }
}

File read_mcap(const testing::fs::path& path) {
  const std::string text = testing::read_text(path);
  const std::string magic("\x89MCAP0\r\n", 8);
  REQUIRE(text.substr(0, 8) == magic);
  REQUIRE(text.substr(text.size() - 8) == magic);
  File file;
  std::map<std::uint16_t, std::string> topics;
  Bytes bytes(text);
  bytes.take(8);
  read_records(bytes, text.size() - 8, file, topics);
  return file;
}

struct Run {
  testing::TemporaryFolder folder;
  ReplayResult result;
};

void write_run(const Mission& mission, Run& run) {
  ReplayOptions options;
  options.prioritization.method = parse_method("random");
  options.max_registrations = 60;
  const auto features =
      std::make_shared<FeatureCache>(mission.scans->loader(), options.registration.features);
  const auto registrar = std::make_shared<testing::OracleRegistrar>(mission.ground_truth);
  ThreadPool pool(1);
  run.result = MissionReplay(mission, options, {features, registrar}).run(pool);
  testing::fs::create_directory(run.folder / "run");
  write_run_folder(run.folder / "run", mission, options, run.result, evaluate_run(mission, run.result), {},
                   PointCloud());
}

}  // namespace

TEST_CASE("mcap: a run becomes messages over mission time", "[evaluation][mcap]") {
  const Mission mission = testing::two_circles();
  Run run;
  write_run(mission, run);
  McapOptions options;
  options.paths = 10;
  const McapResult result = write_run_mcap(run.folder / "run.mcap", run.folder / "run", mission, options);
  REQUIRE(result.notes.empty());
  REQUIRE(result.scans == mission.graph.nodes().size());
  std::size_t verified = 0;
  for (const ComputedCandidate& computed : run.result.computed)
    verified += computed.result.verified() ? 1 : 0;
  REQUIRE(result.closures == verified);

  const File file = read_mcap(run.folder / "run.mcap");
  REQUIRE(file.counted == result.messages);
  REQUIRE(file.messages.size() == result.messages);
  REQUIRE(file.chunks == file.indexed_chunks);
  REQUIRE(file.types ==
          std::map<std::string, std::string>{{"/a/scan", "sensor_msgs/msg/PointCloud2"},
                                             {"/b/scan", "sensor_msgs/msg/PointCloud2"},
                                             {"/a/path", "nav_msgs/msg/Path"},
                                             {"/b/path", "nav_msgs/msg/Path"},
                                             {"/a/odometry", "nav_msgs/msg/Path"},
                                             {"/b/odometry", "nav_msgs/msg/Path"},
                                             {"/closures", "visualization_msgs/msg/MarkerArray"}});
  std::map<std::string, std::size_t> count;
  std::uint64_t last_ns = 0;
  for (const Message& message : file.messages) {
    ++count[message.topic];
    REQUIRE(message.time_ns >= last_ns);
    last_ns = message.time_ns;
  }
  REQUIRE(count["/a/scan"] == 40);
  REQUIRE(count["/closures"] == verified);
  REQUIRE(count["/b/path"] == 11);  // every fourth key frame, and the last

  // The last path of a has all poses of the estimate.
  std::string path;
  for (const Message& message : file.messages) path = message.topic == "/a/path" ? message.data : path;
  Bytes cdr(path.substr(4));
  const auto stamp = [&cdr] {
    cdr.align(4);
    const auto sec = cdr.number<std::int32_t>();
    return static_cast<std::int64_t>(sec) * 1000000000 + cdr.number<std::uint32_t>();
  };
  REQUIRE(stamp() == 39 * 2000000000LL);
  REQUIRE(cdr.string() == std::string("map\0", 4));
  cdr.align(4);
  REQUIRE(cdr.number<std::uint32_t>() == 40);
  for (std::uint64_t i = 0; i < 40; ++i) {
    REQUIRE(stamp() == static_cast<std::int64_t>(i) * 2000000000LL);
    REQUIRE(cdr.string() == std::string("map\0", 4));
    cdr.align(8);
    const Eigen::Isometry3d& pose = run.result.graph.node(make_key('a', i)).pose;
    for (int axis = 0; axis < 3; ++axis)
      REQUIRE(cdr.number<double>() == Approx(pose.translation()[axis]).margin(1e-6));
    for (int k = 0; k < 4; ++k) cdr.number<double>();
  }
  REQUIRE(cdr.end());
}

TEST_CASE("mcap: another mission and a missing scan are named", "[evaluation][mcap][error]") {
  const Mission mission = testing::two_circles();
  Run run;
  write_run(mission, run);
  REQUIRE_THROWS_WITH(write_run_mcap(run.folder / "x.mcap", run.folder / "run", testing::two_circles(1, 10)),
                      Contains("is not of mission"));
  REQUIRE_FALSE(testing::fs::exists(run.folder / "x.mcap"));
  REQUIRE_FALSE(testing::fs::exists(run.folder / "x.mcap.part"));
  Mission without_scans = mission;
  without_scans.scans = std::make_shared<ScanStore>();
  testing::fs::remove(run.folder / "run" / "closures.csv");
  const McapResult result = write_run_mcap(run.folder / "x.mcap", run.folder / "run", without_scans);
  REQUIRE(result.scans == 0);
  REQUIRE(result.notes.size() == 2);  // no closures, no scans
  REQUIRE(read_mcap(run.folder / "x.mcap").counted == result.messages);
}

}  // namespace loopwise::run_mcap_test
