// SPDX-License-Identifier: BSD-3-Clause
// Tiny inputs that claim giant sizes: the result is an error, and no memory is allocated for data that do not
// exist.
#include <filesystem>

#include "allocations.hpp"
#include "lamp_data.hpp"
#include "seeds.hpp"
#include "target.hpp"
#include "testing.hpp"

#include "cloud_points.hpp"
#include "packed.hpp"
#include "ros_message.hpp"
#include "zip_archive.hpp"

#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/gnn.hpp>
#ifdef LOOPWISE_FUZZ_ROSBAG
#include "bag_check.hpp"
#endif

namespace loopwise::giant_sizes_test {
namespace {

namespace fs = std::filesystem;

/// The largest single piece of memory that the call asks for, bytes; the call must throw an InputError.
template <class Call>
std::size_t largest_piece(Call&& call) {
  fuzz::largest_allocation = 0;
  REQUIRE_THROWS_AS(call(), InputError);
  return fuzz::largest_allocation;
}

/// Room for zlib's and bz2's own tables. A header that is believed asks for gigabytes.
constexpr std::size_t kBound = 1 << 20;

/// The header of a PCD whose points have `count` fields more, each of half a megabyte.
std::string wide_fields(int count) {
  std::string names = "FIELDS x y z", sizes = "\nSIZE 4 4 4", types = "\nTYPE F F F",
              counts = "\nCOUNT 1 1 1";
  for (int i = 0; i < count; ++i) {
    names += " f" + std::to_string(i);
    sizes += " 8";
    types += " F";
    counts += " 65536";
  }
  return names + sizes + types + counts;
}

TEST_CASE("giant sizes: clouds", "[fuzz][giant]") {
  const std::string fields = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n";
  const std::string many = "4000000000";
  const std::string encoding = GENERATE("ascii", "binary", "binary_compressed");
  CAPTURE(encoding);
  const std::string data = "VIEWPOINT 0 0 0 1 0 0 0\nDATA " + encoding + "\n" + std::string(16, '\x7f');
  const auto pcd = [](const std::string& text) {
    return largest_piece([&] { static_cast<void>(points::parse_cloud("giant.pcd", text)); });
  };
  CHECK(pcd(fields + "WIDTH " + many + "\nHEIGHT 1\nPOINTS " + many + "\n" + data) < kBound);
  CHECK(pcd(fields + "WIDTH " + many + "\nHEIGHT " + many + "\n" + data) < kBound);
  CHECK(pcd(fields + "POINTS 18446744073709551615\n" + data) < kBound);
  CHECK(pcd(wide_fields(100) + "\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n" + data) < kBound);

  const std::string ply =
      "ply\nformat " + std::string(encoding == "ascii" ? "ascii" : "binary_little_endian") +
      " 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float "
      "z\nend_header\n0 0 0\n";
  CHECK(largest_piece([&] { static_cast<void>(points::parse_cloud("giant.ply", ply)); }) < kBound);
}

TEST_CASE("giant sizes: no points with fields of giant counts", "[fuzz][giant]") {
  const std::string text = wide_fields(1000) + "\nWIDTH 0\nHEIGHT 1\nPOINTS 0\nDATA ascii\n";
  fuzz::largest_allocation = 0;
  CHECK(points::parse_cloud("giant.pcd", text).cloud.empty());
  CHECK(fuzz::largest_allocation < kBound);
}

TEST_CASE("giant sizes: messages", "[fuzz][giant]") {
  const std::string count = "\xff\xff\xff\xff";
  for (const char* definition :
       {"float64[] a\n", "string[] a\n", "string a\n", "B[] a\n===\nMSG: B\nfloat64[1000] b\n"}) {
    CAPTURE(definition);
    const ros1::Schema schema("fuzz_msgs/Giant", definition);
    CHECK(largest_piece([&] { static_cast<void>(ros1::Value(schema, count)); }) < kBound);
  }
  // Elements without bytes: any count of them fits, and none is walked.
  const ros1::Schema nothing("fuzz_msgs/Giant", "B[] a\n===\nMSG: B\nstring[0] b\n");
  const ros1::Value value(nothing, count);
  CHECK(value.at("a").size() == 0xffffffff);
  std::string chain = "T0 a\n";
  for (int i = 0; i < 20000; ++i) {
    chain += "===\nMSG: T" + std::to_string(i) + "\nT" + std::to_string(i + 1) + " a\n";
  }
  chain += "===\nMSG: T20000\nbool a\n";
  CHECK_THROWS_WITH(ros1::Schema("fuzz_msgs/Giant", chain), Contains("deep"));
  CHECK(largest_piece([] {
          static_cast<void>(ros1::Schema("fuzz_msgs/Giant", "float64[18446744073709551615] a\n"));
        }) < kBound);
}

TEST_CASE("giant sizes: JSON and CBOR", "[fuzz][giant]") {
  const testing::TemporaryFolder folder;
  const fs::path weights = folder / "weights.json", packed = folder / "packed.cbor";
  for (const char* shape :
       {"[4294967296, 4294967296]", "[9223372036854775807, 2]", "[18446744073709551615, 1]", "[1e300, 1]"}) {
    CAPTURE(shape);
    testing::write_text(weights,
                        R"({"node_encoder.weight": {"shape": )" + std::string(shape) + R"(, "data": []}})");
    CHECK(largest_piece([&] { static_cast<void>(GraphNetwork(weights)); }) < kBound);
  }
  // An array, a text and bytes of 2^32 - 1 and 2^64 - 1 elements.
  for (const char* head : {"\x9a", "\x7a", "\x5a", "\xba", "\x9b", "\x7b", "\x5b", "\xbb"}) {
    testing::write_text(packed, head + std::string(8, '\xff'));
    CHECK(largest_piece([&] { static_cast<void>(training::read_packed(packed, "x", 1)); }) < kBound);
  }
  // Lists, texts in pieces and bytes in pieces, nested a million deep.
  for (const char head : {'\x81', '\x7f', '\x5f'}) {
    testing::write_text(packed, std::string(1000000, head));
    CHECK(largest_piece([&] { static_cast<void>(training::read_packed(packed, "x", 1)); }) < 4 * kBound);
  }
  CHECK(largest_piece([&] { static_cast<void>(parse_json(std::string(1000000, '['), "deep.json")); }) <
        4 * kBound);
}

#ifdef LOOPWISE_FUZZ_ROSBAG
TEST_CASE("giant sizes: bags", "[fuzz][giant]") {
  const testing::TemporaryFolder folder;
  const fs::path file = folder / "giant.bag";
  const std::string whole = fuzz::bag(fuzz::lamp_messages());
  std::size_t refused = 0;
  // Every length and count of four bytes, one after the other.
  for (std::size_t at = 13; at + 4 <= whole.size(); ++at) {
    const bool length = static_cast<unsigned char>(whole[at + 2]) == 0 && whole[at + 3] == 0;
    if (!length || (at > 80 && at < 4109)) continue;
    std::string bytes = whole;
    bytes.replace(at, 4, "\xff\xff\xff\x3f");
    testing::write_text(file, bytes);
    Problems problems;
    fuzz::largest_allocation = 0;
    try {
      bags::check_bag(file, "giant.bag", problems);
    } catch (const InputError&) {
      ++refused;
    }
    CAPTURE(at);
    REQUIRE(fuzz::largest_allocation < kBound);
  }
  CHECK(refused > 100);
  // An index that leads to the connection before the message, whose fields the library reads as lengths.
  std::string bytes = fuzz::bag({fuzz::lamp_messages()[4]});
  const std::size_t entry = bytes.find("count=", 13 + 4096) + 6 + 4 + 4;
  bytes.replace(entry + 8, 4, 4, '\0');
  testing::write_text(file, bytes);
  Problems problems;
  CHECK_THROWS_WITH(bags::check_bag(file, "giant.bag", problems), Contains("points to byte 0 of the chunk"));
  for (const char* compression : {"none", "bz2", "lz4"}) {
    CAPTURE(compression);
    CHECK(largest_piece([&] {
            static_cast<void>(bags::inflate_chunk(compression, std::string(20, 'B'), bags::kLargestChunk));
          }) < 2 * kBound);
  }
}
#endif

TEST_CASE("giant sizes: archives", "[fuzz][giant]") {
  if (!ZipArchive::available()) {
    SUCCEED("no archives in this build");
    return;
  }
  const testing::TemporaryFolder folder;
  const fs::path file = folder / "giant.zip";
  std::string bytes = fuzz::zip({{"a.pcd", "text"}});
  // The size before and after compression, in the file's own header and in the directory.
  for (const std::size_t at :
       {std::size_t{18}, std::size_t{22}, bytes.find("PK\x01\x02") + 20, bytes.find("PK\x01\x02") + 24}) {
    bytes.replace(at, 4, "\xf0\xff\xff\x7f");
  }
  testing::write_text(file, bytes);
  CHECK(largest_piece([&] { static_cast<void>(ZipArchive(file).read(0)); }) < kBound);
}

#ifdef LOOPWISE_FUZZ_ROSBAG
/// An archive of one file that takes 2^60 bytes, so it says, in the form for sizes of 64 bits.
std::string zip_of_giant(const std::string& name) {
  const std::string none("\x03\x00", 2), sizes("\0\0\0\0\0\0\0\x10\x02\0\0\0\0\0\0\0", 16);
  const std::string extra = std::string("\x01\0\x10\0", 4) + sizes;
  const auto number = [](std::size_t value, std::size_t bytes) {
    std::string out;
    for (std::size_t i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i) & 0xff);
    return out;
  };
  // Version 4.5, deflated, no time, no checksum, sizes elsewhere.
  const std::string common = std::string("\x2d\0\0\0\x08\0\0\0\x21\0\0\0\0\0", 14) + std::string(8, '\xff') +
                             number(name.size(), 2) + number(extra.size(), 2);
  const std::string local = "PK\x03\x04" + common + name + extra + none;
  const std::string directory =
      "PK\x01\x02" + std::string("\x2d\x03", 2) + common + std::string(14, '\0') + name + extra;
  return local + directory + std::string("PK\x05\x06\0\0\0\0\x01\0\x01\0", 12) + number(directory.size(), 4) +
         number(local.size(), 4) + std::string(2, '\0');
}

TEST_CASE("giant sizes: a bag in an archive is not unpacked where it has no room", "[fuzz][giant]") {
  if (!ZipArchive::available()) {
    SUCCEED("no archives in this build");
    return;
  }
  const testing::TemporaryFolder folder;
  testing::write_text(folder / "save.zip", zip_of_giant("pose_graph.bag"));
  CHECK(ZipArchive(folder / "save.zip").size(0) == std::uint64_t{1} << 60);
  CHECK_THROWS_WITH(read_mission(folder / "save.zip"),
                    Catch::Matchers::Contains("the unpacked file needs 1152921504606846976"));
}
#endif

}  // namespace
}  // namespace loopwise::giant_sizes_test
