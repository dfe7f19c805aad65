// SPDX-License-Identifier: BSD-3-Clause
#include "ros2_messages.hpp"

#include <cstring>

namespace loopwise::ros2 {
namespace {

/// Common Data Representation: each number is at a multiple of its size, counted from the end of the first 4
/// bytes.
class Cdr {
 public:
  template <class T>
  void number(T value) {
    static_assert(sizeof(T) <= 8);
    while ((text_.size() - kHead) % sizeof(T) != 0) text_ += '\0';
    std::uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof(T));
    if constexpr (sizeof(T) < 8) bits &= (std::uint64_t{1} << (8 * sizeof(T))) - 1;
    for (std::size_t i = 0; i < sizeof(T); ++i, bits >>= 8) text_ += static_cast<char>(bits & 0xFF);
  }
  void size(std::size_t count) { number(static_cast<std::uint32_t>(count)); }
  void string(const std::string& value) {
    size(value.size() + 1);
    text_.append(value.c_str(), value.size() + 1);
  }
  void vector(const Eigen::Vector3d& v) {
    for (int axis = 0; axis < 3; ++axis) number(v[axis]);
  }
  void pose(const Eigen::Isometry3d& T) {
    vector(T.translation());
    const Eigen::Quaterniond q(T.linear());
    for (const double value : {q.x(), q.y(), q.z(), q.w()}) number(value);
  }
  void header(const Header& header) {
    constexpr std::int64_t kSecond = 1000000000;
    number(static_cast<std::int32_t>(header.stamp_ns / kSecond));
    number(static_cast<std::uint32_t>(header.stamp_ns % kSecond));
    string(header.frame);
  }
  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  static constexpr std::size_t kHead = 4;
  std::string text_ = std::string("\0\1\0\0", kHead);  // CDR, little-endian
};

constexpr const char* kTime = "int32 sec\nuint32 nanosec\n";
constexpr const char* kHeader = "builtin_interfaces/Time stamp\nstring frame_id\n";
constexpr const char* kPoint = "float64 x\nfloat64 y\nfloat64 z\n";
constexpr const char* kQuaternion = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n";
constexpr const char* kPose = "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n";

/// A type within another, in the format of definitions in bags.
std::string part(const std::string& name, const std::string& definition) {
  return std::string(80, '=') + "\nMSG: " + name + "\n" + definition;
}

std::string header_parts() {
  return part("std_msgs/Header", kHeader) + part("builtin_interfaces/Time", kTime);
}

std::string pose_parts() {
  return part("geometry_msgs/Pose", kPose) + part("geometry_msgs/Point", kPoint) +
         part("geometry_msgs/Quaternion", kQuaternion);
}

}  // namespace

MessageType path_type() {
  return {"nav_msgs/msg/Path",
          std::string("std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n") +
              part("geometry_msgs/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose\n") +
              header_parts() + pose_parts()};
}

MessageType point_cloud_type() {
  return {
      "sensor_msgs/msg/PointCloud2",
      std::string("std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
                  "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n") +
          part("sensor_msgs/PointField",
               "uint8 FLOAT32=7\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n") +
          header_parts()};
}

MessageType marker_array_type() {
  return {"visualization_msgs/msg/MarkerArray",
          std::string("visualization_msgs/Marker[] markers\n") +
              part("visualization_msgs/Marker",
                   "int32 LINE_LIST=5\nint32 ADD=0\nstd_msgs/Header header\nstring ns\nint32 id\nint32 type\n"
                   "int32 action\ngeometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\n"
                   "std_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\nbool frame_locked\n"
                   "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring text\n"
                   "string mesh_resource\nbool mesh_use_embedded_materials\n") +
              header_parts() + pose_parts() + part("geometry_msgs/Vector3", kPoint) +
              part("std_msgs/ColorRGBA", "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n") +
              part("builtin_interfaces/Duration", kTime)};
}

std::string path(const Header& header, const std::vector<StampedPose>& poses) {
  Cdr cdr;
  cdr.header(header);
  cdr.size(poses.size());
  for (const StampedPose& pose : poses) {
    cdr.header({pose.stamp_ns, header.frame});
    cdr.pose(pose.pose);
  }
  return cdr.text();
}

std::string point_cloud(const Header& header, const std::vector<Eigen::Vector3f>& points) {
  constexpr std::uint32_t kPointBytes = 12;
  constexpr std::uint8_t kFloat32 = 7;
  Cdr cdr;
  cdr.header(header);
  cdr.number(std::uint32_t{1});
  cdr.size(points.size());
  cdr.size(3);
  for (std::uint32_t axis = 0; axis < 3; ++axis) {
    cdr.string(std::string(1, static_cast<char>('x' + axis)));
    cdr.number(4 * axis);
    cdr.number(kFloat32);
    cdr.number(std::uint32_t{1});
  }
  cdr.number(std::uint8_t{0});  // little-endian
  cdr.number(kPointBytes);
  cdr.size(kPointBytes * points.size());
  cdr.size(kPointBytes * points.size());
  for (const Eigen::Vector3f& point : points) {
    for (int axis = 0; axis < 3; ++axis) cdr.number(point[axis]);
  }
  cdr.number(std::uint8_t{1});  // no point is invalid
  return cdr.text();
}

std::string marker_array(const Header& header, const std::vector<LineList>& lines) {
  constexpr std::int32_t kLineList = 5, kAdd = 0;
  Cdr cdr;
  cdr.size(lines.size());
  for (const LineList& list : lines) {
    cdr.header(header);
    cdr.string(list.name);
    cdr.number(list.id);
    cdr.number(kLineList);
    cdr.number(kAdd);
    cdr.pose(Eigen::Isometry3d::Identity());
    cdr.vector({list.width_m, 0.0, 0.0});
    for (const float value : list.colour) cdr.number(value);
    cdr.number(std::int32_t{0});  // shown until the end
    cdr.number(std::uint32_t{0});
    cdr.number(std::uint8_t{0});  // not locked to its frame
    cdr.size(list.points.size());
    for (const Eigen::Vector3d& point : list.points) cdr.vector(point);
    cdr.size(0);  // one colour for all
    cdr.string("");
    cdr.string("");
    cdr.number(std::uint8_t{0});
  }
  return cdr.text();
}

}  // namespace loopwise::ros2
