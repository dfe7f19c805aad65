// SPDX-License-Identifier: BSD-3-Clause
#include "lamp_data.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <stdexcept>

#ifdef LOOPWISE_FUZZ_ROSBAG
#include <bzlib.h>
#include <roslz4/lz4s.h>
#endif

namespace loopwise::fuzz {
namespace {

#define LOOPWISE_RULE \
  "\n================================================================================\nMSG: "
#define LOOPWISE_HEADER LOOPWISE_RULE "std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
#define LOOPWISE_POSE                                                                        \
  LOOPWISE_RULE "geometry_msgs/Pose\nPoint position\nQuaternion orientation\n" LOOPWISE_RULE \
                "geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n" LOOPWISE_RULE       \
                "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"

constexpr const char* kKeyedScan =
    "uint64 key\nsensor_msgs/PointCloud2 scan\n" LOOPWISE_RULE
    "sensor_msgs/PointCloud2\nHeader header\nuint32 height\nuint32 width\nPointField[] fields\n"
    "bool is_bigendian # of the data\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool "
    "is_dense\n" LOOPWISE_HEADER LOOPWISE_RULE
    "sensor_msgs/PointField\nuint8 INT8 = 1\nuint8 FLOAT64 = 8\nstring name\nuint32 offset\nuint8 datatype\n"
    "uint32 count\n";
constexpr const char* kPoseGraph =
    "Header header\nbool incremental\nPoseGraphNode[] nodes\nPoseGraphEdge[] edges\n" LOOPWISE_HEADER
        LOOPWISE_POSE LOOPWISE_RULE
    "pose_graph_msgs/PoseGraphNode\nHeader header\nuint64 key\nstring ID\ngeometry_msgs/Pose pose\n"
    "float64[36] covariance\n" LOOPWISE_RULE
    "pose_graph_msgs/PoseGraphEdge\nint32 ODOM = 0\nint32 PRIOR = 1\nuint64 key_from\nuint64 key_to\nint32 "
    "type\n"
    "geometry_msgs/Pose pose\nfloat64[36] covariance\nfloat64 range\nfloat64 range_error\n";
constexpr const char* kBeacons =
    "Header header\nCommNodeInfo[] remaining\nCommNodeInfo[] dropped\n" LOOPWISE_HEADER LOOPWISE_POSE
        LOOPWISE_RULE
    "pose_graph_msgs/CommNodeInfo\nstring hostname\nstring uwb_id\nstring robot_name\nuint64 pose_graph_key\n"
    "geometry_msgs/Pose relative_pose\n";
constexpr const char* kRadio =
    "Header header\nSilvusStreamscapeNode[] nodes\n" LOOPWISE_HEADER LOOPWISE_RULE
    "silvus_msgs/SilvusStreamscapeNode\nint32 node_id\nstring node_label\nstring robot_name\n"
    "SilvusStreamscapeNeighbor[] neighbors\n" LOOPWISE_RULE
    "silvus_msgs/SilvusStreamscapeNeighbor\nint32 my_node_id\nfloat32 my_txpw_actual_dBm\n"
    "string neighbor_node_label\nint32[] received_signal_power_dBm\n";
constexpr const char* kOdometry =
    "Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n" LOOPWISE_HEADER
        LOOPWISE_POSE LOOPWISE_RULE "geometry_msgs/PoseWithCovariance\nPose pose\nfloat64[36] covariance\n";

#undef LOOPWISE_RULE
#undef LOOPWISE_HEADER
#undef LOOPWISE_POSE

constexpr std::uint64_t kFirst = std::uint64_t{'a'} << 56;

/// Little-endian, as ROS writes.
class Bytes {
 public:
  template <class T>
  Bytes& put(T value) {
    char bytes[sizeof(T)];
    std::memcpy(bytes, &value, sizeof(T));
    text_.append(bytes, sizeof(T));
    return *this;
  }
  Bytes& raw(std::string_view bytes) {
    text_ += bytes;
    return *this;
  }
  Bytes& text(std::string_view value) { return put(static_cast<std::uint32_t>(value.size())).raw(value); }
  Bytes& time(std::uint32_t second) { return put(kBagStart + second).put(std::uint32_t{0}); }
  Bytes& header(std::uint32_t second) { return put(std::uint32_t{0}).time(second).text("world"); }
  Bytes& pose(double x) {
    for (const double value : {x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0}) put(value);
    return *this;
  }
  Bytes& covariance(double variance) {
    for (int i = 0; i < 36; ++i) put(i % 7 == 0 ? variance : 0.0);
    return *this;
  }
  Bytes& edge(std::uint64_t from, std::uint64_t to, std::int32_t type, double x) {
    return put(kFirst + from).put(kFirst + to).put(type).pose(x).covariance(0.01).put(3.0).put(0.1);
  }
  [[nodiscard]] const std::string& str() const { return text_; }

 private:
  std::string text_;
};

std::string scan(std::uint64_t key) {
  Bytes out;
  out.put(kFirst + key).header(0).put(std::uint32_t{1}).put(std::uint32_t{3}).put(std::uint32_t{4});
  std::uint32_t offset = 0;
  for (const char* name : {"x", "y", "z", "intensity"}) {
    out.text(name).put(offset).put(std::uint8_t{7}).put(std::uint32_t{1});
    offset += 4;
  }
  out.put(std::uint8_t{0}).put(std::uint32_t{16}).put(std::uint32_t{48}).put(std::uint32_t{48});
  for (int i = 0; i < 12; ++i) out.put(static_cast<float>(i));
  return out.put(std::uint8_t{1}).str();
}

std::string graph() {
  Bytes out;
  out.header(0).put(std::uint8_t{1}).put(std::uint32_t{2});
  for (std::uint64_t i = 0; i < 2; ++i) {
    out.header(static_cast<std::uint32_t>(2 * i)).put(kFirst + i).text("odom_node");
    out.pose(static_cast<double>(i)).covariance(0.0);
  }
  constexpr std::uint64_t kArtifact = std::uint64_t{0} - (std::uint64_t{'a' - 'A'} << 56);  // from a0 to A0
  out.put(std::uint32_t{6}).edge(0, 0, 1, 0.0).edge(0, 1, 0, 1.0).edge(1, 0, 3, -1.0).edge(0, 0, 2, 0.0);
  return out.edge(0, 1, 5, 0.0).edge(0, kArtifact, 4, 2.0).str();
}

/// A field of a bag's record.
void put_field(Bytes& out, std::string_view name, std::string_view value) {
  out.text(std::string(name) + "=" + std::string(value));
}
template <class T>
std::string number(T value) {
  return Bytes().put(value).str();
}
using Fields = std::vector<std::pair<const char*, std::string>>;
std::string record(const Fields& fields, std::string_view data) {
  Bytes header;
  for (const auto& [name, value] : fields) put_field(header, name, value);
  return Bytes().text(header.str()).text(data).str();
}
std::string connection(std::uint32_t id, const BagConnection& about) {
  Bytes data;
  put_field(data, "topic", about.topic);
  put_field(data, "type", about.name);
  put_field(data, "md5sum", "00000000000000000000000000000000");
  put_field(data, "message_definition", about.definition);
  return record({{"op", number(std::uint8_t{7})}, {"conn", number(id)}, {"topic", about.topic}}, data.str());
}
std::string time(std::uint32_t second) {
  return Bytes().time(second).str();
}

struct Chunk {
  std::string bytes;
  std::map<std::uint32_t, std::string> index;  // by connection
  std::uint32_t first = 0, last = 0;           // seconds
};
template <class Messages>
Chunk chunk_of(Messages message, Messages end, const std::vector<BagConnection>& types) {
  Chunk chunk{{}, {}, message->second, message->second};
  for (; message != end; ++message) {
    const auto id = static_cast<std::uint32_t>(message->type);
    if (chunk.index.count(id) == 0) chunk.bytes += connection(id, types.at(id));
    chunk.index[id] += time(message->second) + number(static_cast<std::uint32_t>(chunk.bytes.size()));
    chunk.bytes +=
        record({{"op", number(std::uint8_t{2})}, {"conn", number(id)}, {"time", time(message->second)}},
               message->bytes);
    chunk.first = std::min(chunk.first, message->second);
    chunk.last = std::max(chunk.last, message->second);
  }
  return chunk;
}

std::uint32_t crc32(std::string_view bytes) {
  std::uint32_t crc = ~std::uint32_t{0};
  for (const char byte : bytes) {
    crc ^= static_cast<unsigned char>(byte);
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
  }
  return ~crc;
}

}  // namespace

const std::vector<MessageType>& message_types() {
  static const std::vector<MessageType> types = {
      {"pose_graph_msgs/KeyedScan", "/husky1/keyed_scans", kKeyedScan},
      {"pose_graph_msgs/PoseGraph", "/husky1/pose_graph", kPoseGraph},
      {"pose_graph_msgs/CommNodeStatus", "/husky1/comm", kBeacons},
      {"silvus_msgs/SilvusStreamscape", "/husky1/radio", kRadio},
      {"nav_msgs/Odometry", "/husky1/truth", kOdometry}};
  return types;
}

const std::vector<BagConnection>& bag_connections() {
  static const std::vector<BagConnection> connections = [] {
    std::vector<BagConnection> out;
    for (const MessageType& type : message_types()) out.push_back({type.name, type.topic, type.definition});
    return out;
  }();
  return connections;
}

std::vector<TypedMessage> lamp_messages() {
  Bytes beacons, radio, odometry;
  beacons.header(1).put(std::uint32_t{0}).put(std::uint32_t{1});
  beacons.text("beacon1").text("u1").text("husky1").put(kFirst).pose(0.0);
  radio.header(2).put(std::uint32_t{1}).put(std::int32_t{7}).text("scom-husky1").text("husky1");
  radio.put(std::uint32_t{1}).put(std::int32_t{7}).put(20.0f).text("beacon1").put(std::uint32_t{2});
  radio.put(std::int32_t{-60}).put(std::int32_t{-61});
  odometry.header(2).text("base").pose(1.0).covariance(0.1);
  return {{1, graph(), 0},       {0, scan(0), 1},     {0, scan(1), 2},
          {2, beacons.str(), 3}, {3, radio.str(), 4}, {4, odometry.str(), 5}};
}

std::string compressed(const std::string& how, const std::string& bytes) {
  if (how == "none") return bytes;
#ifdef LOOPWISE_FUZZ_ROSBAG
  std::string in = bytes, out(bytes.size() * 2 + 1000, '\0');
  auto filled = static_cast<unsigned>(out.size());
  const bool done =
      how == "bz2" ? BZ2_bzBuffToBuffCompress(out.data(), &filled, in.data(),
                                              static_cast<unsigned>(in.size()), 1, 0, 0) == BZ_OK
                   : how == "lz4" && roslz4_buffToBuffCompress(in.data(), static_cast<unsigned>(in.size()),
                                                               out.data(), &filled, 4) == ROSLZ4_OK;
  if (done) return out.substr(0, filled);
#endif
  throw std::runtime_error("cannot compress by " + how);
}

std::string bag(const std::vector<TypedMessage>& messages, const BagLayout& layout,
                const std::vector<BagConnection>& types) {
  constexpr std::size_t kRoom = 4096;  // of the bag's header
  const std::string magic = "#ROSBAG V2.0\n";
  const std::uint64_t body_at = magic.size() + kRoom;
  std::string body, infos;
  std::map<std::uint32_t, std::string> connections;
  std::uint32_t chunks = 0;
  for (std::size_t begin = 0; begin < messages.size(); begin += layout.messages_per_chunk) {
    const auto first = messages.begin() + static_cast<std::ptrdiff_t>(begin);
    const std::size_t size = std::min(layout.messages_per_chunk, messages.size() - begin);
    const Chunk chunk = chunk_of(first, first + static_cast<std::ptrdiff_t>(size), types);
    const std::uint64_t chunk_at = body_at + body.size();
    body += record({{"op", number(std::uint8_t{5})},
                    {"compression", layout.compression},
                    {"size", number(static_cast<std::uint32_t>(chunk.bytes.size()))}},
                   compressed(layout.compression, chunk.bytes));
    std::string counts;
    for (const auto& [id, entries] : chunk.index) {
      const auto count = static_cast<std::uint32_t>(entries.size() / 12);
      body += record({{"op", number(std::uint8_t{4})},
                      {"ver", number(std::uint32_t{1})},
                      {"conn", number(id)},
                      {"count", number(count)}},
                     entries);
      counts += number(id) + number(count);
      connections.emplace(id, connection(id, types.at(id)));
    }
    infos += record({{"op", number(std::uint8_t{6})},
                     {"ver", number(std::uint32_t{1})},
                     {"chunk_pos", number(chunk_at)},
                     {"start_time", time(chunk.first)},
                     {"end_time", time(chunk.last)},
                     {"count", number(static_cast<std::uint32_t>(chunk.index.size()))}},
                    counts);
    ++chunks;
  }
  const auto head = [&](std::size_t padding) {
    return record({{"op", number(std::uint8_t{3})},
                   {"index_pos", number(std::uint64_t{body_at + body.size()})},
                   {"conn_count", number(static_cast<std::uint32_t>(connections.size()))},
                   {"chunk_count", number(chunks)}},
                  std::string(padding, ' '));
  };
  std::string out = magic + head(kRoom - head(0).size()) + body;
  for (const auto& [id, bytes] : connections) out += bytes;
  return out + infos;
}

std::string zip(const std::vector<std::pair<std::string, std::string>>& files) {
  Bytes out, directory;
  for (const auto& [name, contents] : files) {
    const auto at = static_cast<std::uint32_t>(out.str().size());
    Bytes common;  // version, flags, method, time, date, checksum, sizes, lengths of name and extra
    common.put(std::uint16_t{20}).put(std::uint16_t{0}).put(std::uint16_t{0}).put(std::uint16_t{0});
    common.put(std::uint16_t{33}).put(crc32(contents)).put(static_cast<std::uint32_t>(contents.size()));
    common.put(static_cast<std::uint32_t>(contents.size())).put(static_cast<std::uint16_t>(name.size()));
    common.put(std::uint16_t{0});
    out.put(std::uint32_t{0x04034b50}).raw(common.str()).raw(name).raw(contents);
    directory.put(std::uint32_t{0x02014b50}).put(std::uint16_t{20}).raw(common.str()).put(std::uint16_t{0});
    directory.put(std::uint16_t{0}).put(std::uint16_t{0}).put(std::uint32_t{0}).put(at).raw(name);
  }
  const auto at = static_cast<std::uint32_t>(out.str().size());
  const auto count = static_cast<std::uint16_t>(files.size());
  Bytes end;
  end.put(std::uint32_t{0x06054b50}).put(std::uint16_t{0}).put(std::uint16_t{0}).put(count).put(count);
  end.put(static_cast<std::uint32_t>(directory.str().size())).put(at).put(std::uint16_t{0});
  return out.str() + directory.str() + end.str();
}

}  // namespace loopwise::fuzz
