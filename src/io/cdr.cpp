// SPDX-License-Identifier: BSD-3-Clause
#include "cdr.hpp"

#include <algorithm>
#include <cstdint>

#include <loopwise/core/error.hpp>

#include "text.hpp"

namespace loopwise::ros1 {

/// Walks a message by its schema; a friend of Schema.
class CdrReader {
 public:
  CdrReader(const Schema& schema, std::string_view bytes) : schema_(schema) {
    constexpr std::size_t kEncapsulation = 4;
    if (bytes.size() < kEncapsulation)
      fail("a message of " + std::to_string(bytes.size()) + " bytes is not CDR");
    const auto kind = static_cast<unsigned char>(bytes[1]);
    if (bytes[0] != 0 || kind > 1) {
      fail("unsupported encoding " + std::to_string(static_cast<unsigned char>(bytes[0])) + " " +
           std::to_string(kind) + " of the message, expected plain CDR (0 0 or 0 1)");
    }
    big_endian_ = kind == 0;
    body_ = bytes.substr(kEncapsulation);
  }

  std::string read() {
    constexpr std::size_t kPadding = 3;  // to a multiple of four bytes
    out_.reserve(body_.size());
    message(0);
    if (body_.size() - at_ > kPadding) {
      fail("the message has " + std::to_string(body_.size()) + " bytes, its definition needs " +
           std::to_string(at_));
    }
    return std::move(out_);
  }

 private:
  [[noreturn]] void fail(const std::string& why) const { throw InputError(schema_.type() + ": " + why); }

  [[nodiscard]] std::size_t left() const { return body_.size() - at_; }

  void align(std::size_t size) {
    const std::size_t padding = (size - at_ % size) % size;
    if (padding > left()) fail("byte " + std::to_string(at_) + ": the message is cut short");
    at_ += padding;
  }

  /// Numbers of `size` bytes each, in the byte order of ROS 1.
  void numbers(std::size_t size, std::uint64_t count) {
    if (count == 0) return;
    align(size);
    if (count > left() / size) {
      fail("byte " + std::to_string(at_) + ": " + std::to_string(count) + " numbers of " +
           std::to_string(size) + " bytes, " + std::to_string(left()) +
           " bytes are left: the message is cut short");
    }
    const std::size_t begin = out_.size(), bytes = size * static_cast<std::size_t>(count);
    out_.append(body_.substr(at_, bytes));
    at_ += bytes;
    if (!big_endian_ || size == 1) return;
    for (std::size_t i = begin; i < out_.size(); i += size) {
      std::reverse(out_.begin() + static_cast<std::ptrdiff_t>(i),
                   out_.begin() + static_cast<std::ptrdiff_t>(i + size));
    }
  }

  [[nodiscard]] std::uint32_t length_at(std::size_t place) const {
    std::uint32_t value = 0;
    for (std::size_t i = 4; i-- > 0;) value = value << 8 | static_cast<unsigned char>(out_[place + i]);
    return value;
  }

  void text() {
    const std::size_t place = out_.size();
    numbers(4, 1);
    const std::uint32_t size = length_at(place);
    if (size == 0) return;  // some writers omit the final zero of an empty string
    if (size > left()) {
      fail("byte " + std::to_string(at_) + ": a string of " + std::to_string(size) + " bytes, " +
           std::to_string(left()) + " are left");
    }
    if (body_[at_ + size - 1] != '\0') {
      fail("byte " + std::to_string(at_) +
           ": a string without terminating zero: the message does not match its definition");
    }
    for (std::size_t i = 0; i < 4; ++i) out_[place + i] = static_cast<char>((size - 1) >> (8 * i) & 255);
    out_.append(body_.substr(at_, size - 1));
    at_ += size;
  }

  void elements(std::size_t number, std::uint64_t count) {
    const Schema::Type& type = schema_.types_[number];
    switch (type.primitive) {
      case Primitive::kString:
        for (std::uint64_t i = 0; i < count; ++i) text();
        return;
      case Primitive::kTime:
      case Primitive::kDuration:
        numbers(4, 2 * count);
        return;
      case Primitive::kMessage:
        // Elements without bytes are skipped: the size of the message does not bound their count.
        for (std::uint64_t i = 0; type.least > 0 && i < count; ++i) message(number);
        return;
      default:
        numbers(static_cast<std::size_t>(*type.size), count);
    }
  }

  void message(std::size_t number) {
    for (const Schema::Field& field : schema_.types_[number].fields) {
      if (!field.array) {
        elements(field.type, 1);
        continue;
      }
      std::uint64_t count = field.count.value_or(0);
      if (!field.count) {
        const std::size_t place = out_.size();
        numbers(4, 1);
        count = length_at(place);
      }
      // No element is shorter in CDR than in ROS 1.
      const std::uint64_t least = schema_.types_[field.type].least;
      if (least > 0 && count > left() / least) {
        fail("field " + field.name + ": " + std::to_string(count) + " elements of at least " +
             std::to_string(least) + " bytes, " + std::to_string(left()) + " bytes are left");
      }
      elements(field.type, count);
    }
  }

  const Schema& schema_;
  std::string_view body_;
  std::size_t at_ = 0;
  bool big_endian_ = false;
  std::string out_;
};

}  // namespace loopwise::ros1

namespace loopwise::cdr {
namespace {

constexpr std::string_view kHeader = "MSG: std_msgs/Header\ntime stamp\nstring frame_id\n";
constexpr std::string_view kPoseParts =
    "MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n===\n"
    "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n===\n"
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n";
constexpr std::string_view kPoseWithCovariance =
    "MSG: geometry_msgs/PoseWithCovariance\nPose pose\nfloat64[36] covariance\n";
constexpr std::string_view kTwist =
    "MSG: geometry_msgs/TwistWithCovariance\nTwist twist\nfloat64[36] covariance\n===\n"
    "MSG: geometry_msgs/Twist\nVector3 linear\nVector3 angular\n===\n"
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
constexpr std::string_view kTransform =
    "MSG: geometry_msgs/TransformStamped\nHeader header\nstring child_frame_id\nTransform transform\n===\n"
    "MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n===\n"
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
constexpr std::string_view kCloudFields =
    "Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\nuint32 point_step\n"
    "uint32 row_step\nuint8[] data\nbool is_dense\n";
constexpr std::string_view kPointField =
    "MSG: sensor_msgs/PointField\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n";
constexpr std::string_view kGraphParts =
    "MSG: pose_graph_msgs/PoseGraphNode\nHeader header\nuint64 key\nstring id\ngeometry_msgs/Pose pose\n"
    "float64[36] covariance\n===\n"
    "MSG: pose_graph_msgs/PoseGraphEdge\nuint64 key_from\nuint64 key_to\nint32 type\ngeometry_msgs/Pose "
    "pose\n"
    "float64[36] covariance\nfloat64 range\nfloat64 range_error\n";
constexpr std::string_view kBeacon =
    "MSG: pose_graph_msgs/CommNodeInfo\nstring hostname\nstring uwb_id\nstring robot_name\n"
    "uint64 pose_graph_key\ngeometry_msgs/Pose relative_pose\n";

std::string definition_of(std::string_view own, std::initializer_list<std::string_view> parts) {
  std::string out(own);
  for (const std::string_view part : parts) (out += "===\n") += part;
  return out;
}

/// The type of a field without the bounds of ROS 2, and with the time types of ROS 1.
std::string field_type(std::string_view word) {
  std::string array;
  if (const std::size_t bracket = word.find('['); bracket != std::string_view::npos) {
    array = word.substr(bracket, 3) == "[<=" ? "[]" : std::string(word.substr(bracket));
    word = word.substr(0, bracket);
  }
  std::string type = ros1_type(word.substr(0, word.find("<=")));
  if (type == "builtin_interfaces/Time") type = "time";
  if (type == "builtin_interfaces/Duration") type = "duration";
  return type + array;
}

}  // namespace

std::string ros1_type(std::string_view type) {
  constexpr std::string_view kFolder = "/msg/";
  const std::size_t at = type.find(kFolder);
  if (at == std::string_view::npos) return std::string(type);
  return std::string(type.substr(0, at + 1)) + std::string(type.substr(at + kFolder.size()));
}

std::string ros1_definition(std::string_view definition) {
  std::string out;
  text::Lines lines(definition);
  for (std::string_view line; lines.next(line);) {
    std::string_view rest = line;
    const std::string_view word = text::next_word(rest);
    if (word.empty()) continue;
    if (word.find_first_not_of('=') == std::string_view::npos) {
      out += "===\n";
    } else if (word == "MSG:") {
      out += "MSG: " + ros1_type(text::next_word(rest)) + "\n";
    } else {
      rest = text::trim(rest);
      const std::size_t end = rest.find_first_of("= \t#");
      const std::string_view name = rest.substr(0, end);
      const std::string_view after = end == std::string_view::npos ? "" : text::trim(rest.substr(end));
      if (!after.empty() && after[0] == '=') continue;  // a constant
      (out += field_type(word)) += " " + std::string(name) + "\n";
    }
  }
  return out;
}

std::string known_definition(const std::string& type) {
  if (type == "sensor_msgs/PointCloud2") return definition_of(kCloudFields, {kHeader, kPointField});
  if (type == "geometry_msgs/PoseStamped")
    return definition_of("Header header\nPose pose\n", {kHeader, kPoseParts});
  if (type == "geometry_msgs/PoseWithCovarianceStamped")
    return definition_of("Header header\nPoseWithCovariance pose\n",
                         {kHeader, kPoseWithCovariance, kPoseParts});
  if (type == "nav_msgs/Odometry") {
    return definition_of(
        "Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n",
        {kHeader, kPoseWithCovariance, kPoseParts, kTwist});
  }
  if (type == "tf2_msgs/TFMessage")
    return definition_of("geometry_msgs/TransformStamped[] transforms\n", {kHeader, kTransform, kPoseParts});
  if (type == "pose_graph_msgs/KeyedScan") {
    return definition_of(
        "uint64 key\nsensor_msgs/PointCloud2 scan\n",
        {std::string("MSG: sensor_msgs/PointCloud2\n") + std::string(kCloudFields), kHeader, kPointField});
  }
  if (type == "pose_graph_msgs/PoseGraph") {
    return definition_of("Header header\nbool incremental\nPoseGraphNode[] nodes\nPoseGraphEdge[] edges\n",
                         {kHeader, kGraphParts, kPoseParts});
  }
  if (type == "pose_graph_msgs/CommNodeStatus") {
    return definition_of("Header header\nCommNodeInfo[] remaining\nCommNodeInfo[] dropped\n",
                         {kHeader, kBeacon, kPoseParts});
  }
  return {};
}

std::string to_ros1(const ros1::Schema& schema, std::string_view bytes) {
  return ros1::CdrReader(schema, bytes).read();
}

}  // namespace loopwise::cdr
