// SPDX-License-Identifier: BSD-3-Clause
// Messages of ROS 2 by their definitions, byte by byte.
#include <loopwise/core/error.hpp>

#include "cdr.hpp"
#include "testing.hpp"

namespace loopwise::cdr_test {
namespace {

using namespace std::string_literals;

const std::string kLittle = "\0\1\0\0"s, kBig = "\0\0\0\0"s;

ros1::Schema schema_of(const std::string& definition) {
  return {"test_msgs/Test", cdr::ros1_definition(definition)};
}

TEST_CASE("cdr: numbers are aligned relative to the end of the header, in either byte order", "[io][cdr]") {
  const ros1::Schema schema = schema_of("uint8 a\nfloat64 b\nuint16[] c\nstring d\nint32 e\n");
  const std::string little = kLittle + "\7" + std::string(7, '\0') + "\0\0\0\0\0\0\xf0\x3f"s +
                             "\2\0\0\0\1\0\2\0"s + "\3\0\0\0hi\0"s + "\0"s + "\xfe\xff\xff\xff"s;
  const std::string big = kBig + "\7" + std::string(7, '\0') + "\x3f\xf0\0\0\0\0\0\0"s + "\0\0\0\2\0\1\0\2"s +
                          "\0\0\0\3hi\0"s + "\0"s + "\xff\xff\xff\xfe"s;
  for (const std::string& bytes : {little, big}) {
    const std::string ros1 = cdr::to_ros1(schema, bytes);
    const ros1::Value value(schema, ros1);
    CHECK(value.at("a").integer() == 7);
    CHECK(value.at("b").number() == 1.0);
    CHECK(value.at("c").numbers() == std::vector<double>{1.0, 2.0});
    CHECK(value.at("d").text() == "hi");
    CHECK(value.at("e").integer() == -2);
  }
  // Padding to four bytes at the end is no part of the message; more bytes are an error.
  CHECK(cdr::to_ros1(schema, little + "\0\0\0"s) == cdr::to_ros1(schema, little));
  CHECK_THROWS_WITH(cdr::to_ros1(schema, little + "\0\0\0\0"s), Contains("its definition needs"));
}

TEST_CASE("cdr: an empty sequence aligns nothing", "[io][cdr]") {
  const ros1::Schema schema = schema_of("float64[] a\nuint8 b\n");
  const std::string ros1 = cdr::to_ros1(schema, kLittle + "\0\0\0\0\5"s);
  CHECK(ros1::Value(schema, ros1).at("b").integer() == 5);
}

TEST_CASE("cdr: additions of ROS 2 to definitions", "[io][cdr]") {
  const std::string definition =
      "# a comment\n"
      "int32 SIZE=5\n"
      "string NAME = \"a = b\"\n"
      "std_msgs/msg/Header header\n"
      "string<=10 name \"a = # b\"\n"
      "float32[<=3] some [1.0, 2.0]\n"
      "uint8[2] two\n"
      "bool flag true\n"
      "builtin_interfaces/Duration d\n"
      "================================================================================\n"
      "MSG: std_msgs/msg/Header\n"
      "builtin_interfaces/msg/Time stamp\n"
      "string frame_id\n"
      "================================================================================\n"
      "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
  const ros1::Schema schema = schema_of(definition);
  const std::string bytes = kLittle + "\2\0\0\0\3\0\0\0"s + "\1\0\0\0\0"s + "\0\0\0"s + "\2\0\0\0n\0"s +
                            "\0\0"s + "\1\0\0\0\0\0\x80\x3f"s + "\x08\x09\1"s + "\0"s + "\0\0\0\0\0\0\0\0"s;
  const std::string ros1 = cdr::to_ros1(schema, bytes);
  const ros1::Value value(schema, ros1);
  CHECK(value.at("header").at("stamp").time_ns() == 2'000'000'003);
  CHECK(value.at("header").at("frame_id").text().empty());
  CHECK(value.at("name").text() == "n");
  CHECK(value.at("some").numbers() == std::vector<double>{1.0});
  CHECK(value.at("two").numbers() == std::vector<double>{8.0, 9.0});
  CHECK(value.at("flag").integer() == 1);
  CHECK_FALSE(value.has("SIZE"));
}

TEST_CASE("cdr: false sizes and other encodings are refused", "[io][cdr][error]") {
  const ros1::Schema schema = schema_of("string[] a\n");
  const auto fails = [&](const std::string& bytes, const std::string& why) {
    CHECK_THROWS_WITH(cdr::to_ros1(schema, bytes), Contains("test_msgs/Test") && Contains(why));
    CHECK_THROWS_AS(cdr::to_ros1(schema, bytes), InputError);
  };
  fails("", "is not CDR");
  fails("\0\3\0\0"s, "encoding 0 3");
  fails("\0\x09\0\0"s, "expected plain CDR");
  fails(kLittle, "cut short");
  fails(kLittle + "\xff\xff\xff\xff"s, "4294967295 elements");
  fails(kLittle + "\1\0\0\0\xff\xff\xff\xff"s, "a string of 4294967295 bytes");
  fails(kLittle + "\1\0\0\0\2\0\0\0ab"s, "terminating zero");
  // Elements that take no bytes have no end.
  const ros1::Schema empty("a/B", "C[] c\n===\nMSG: a/C\n");
  CHECK(cdr::to_ros1(empty, kLittle + "\xff\xff\xff\xff"s).size() == 4);
}

TEST_CASE("cdr: every known definition can be read", "[io][cdr]") {
  for (const char* type :
       {"sensor_msgs/PointCloud2", "geometry_msgs/PoseStamped", "nav_msgs/Odometry",
        "geometry_msgs/PoseWithCovarianceStamped", "tf2_msgs/TFMessage", "pose_graph_msgs/KeyedScan",
        "pose_graph_msgs/PoseGraph", "pose_graph_msgs/CommNodeStatus"}) {
    CAPTURE(type);
    CHECK_NOTHROW(ros1::Schema(type, cdr::known_definition(type)));
  }
  CHECK(cdr::known_definition("sensor_msgs/Imu").empty());
  CHECK(cdr::ros1_type("nav_msgs/msg/Odometry") == "nav_msgs/Odometry");
}

}  // namespace
}  // namespace loopwise::cdr_test
