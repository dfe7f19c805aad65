// SPDX-License-Identifier: BSD-3-Clause
// Tiny inputs that claim giant sizes: an error, and no memory taken for what is not there.
#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <new>

#include "lamp_data.hpp"
#include "seeds.hpp"
#include "target.hpp"
#include "testing.hpp"

#include "cloud_points.hpp"
#include "packed.hpp"
#include "ros_message.hpp"
#include "zip_archive.hpp"

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/io/mission.hpp>
#include <loopwise/prioritization/gnn.hpp>
#ifdef LOOPWISE_FUZZ_ROSBAG
#include "bag_check.hpp"
#endif

namespace {

std::atomic<std::size_t> largest{0};

std::atomic<long> until_none{0};  // requests to the one that finds no memory; 0: all find some

void note(std::size_t size) {
  std::size_t before = largest;
  while (before < size && !largest.compare_exchange_weak(before, size)) {
  }
}

}  // namespace

// Every request for memory of this program passes here. Not inlined: gcc would take free() for a mistake.
[[gnu::noinline]] void* operator new(std::size_t size) {
  note(size);
  const bool none = until_none > 0 && --until_none == 0;
  if (void* const memory = none ? nullptr : std::malloc(size > 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
// Sanitizers bring this one themselves, and what it gives would then be freed by ours.
[[gnu::noinline]] void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  note(size);
  return std::malloc(size > 0 ? size : 1);
}
[[gnu::noinline]] void operator delete(void* memory) noexcept {
  std::free(memory);
}
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept {
  std::free(memory);
}

namespace loopwise {
namespace {

namespace fs = std::filesystem;

/// The largest single piece of memory that the call asks for, bytes; the call must throw an InputError.
template <class Call>
std::size_t largest_piece(Call&& call) {
  largest = 0;
  REQUIRE_THROWS_AS(call(), InputError);
  return largest;
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
  largest = 0;
  CHECK(points::parse_cloud("giant.pcd", text).cloud.empty());
  CHECK(largest < kBound);
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
    largest = 0;
    try {
      bags::check_bag(file, "giant.bag", problems);
    } catch (const InputError&) {
      ++refused;
    }
    CAPTURE(at);
    REQUIRE(largest < kBound);
  }
  CHECK(refused > 100);
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

TEST_CASE("without memory: a value of an option that cannot be copied", "[fuzz][error]") {
  using detail::OptionValue;
  for (const OptionValue& value :
       {OptionValue(std::string(100, 'x')), OptionValue(detail::OptionNumbers{{1.0, 2.0, 3.0}})}) {
    until_none = 1;
    REQUIRE_THROWS_AS(OptionValue(value), std::bad_alloc);
  }
}

TEST_CASE("without memory: a file is written whole or not at all", "[fuzz][error]") {
  const testing::TemporaryFolder folder;
  const fs::path file = folder / "a_name_that_is_long_enough_to_ask_for_memory.txt";
  const std::string text = "new";
  testing::write_text(file, "old");
  bool written = false;
  long missing = 0;
  while (!written) {
    const fs::path own = file;
    until_none = missing + 1;
    try {
      write_file(own, text);
      written = true;
    } catch (const std::bad_alloc&) {
      ++missing;
    }
    until_none = 0;
    REQUIRE(testing::read_text(file) == (written ? "new" : "old"));
  }
  REQUIRE(missing >= 3);
  REQUIRE(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()) == 1);
}

}  // namespace
}  // namespace loopwise
