// SPDX-License-Identifier: BSD-3-Clause
// Bags that were cut short or altered at any byte: the result is an error or a reported problem, never a
// crash.
#include <cstring>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>

#include "lamp_testing.hpp"
#include "ros_message.hpp"

namespace loopwise::bag_damage_test {
namespace {

namespace fs = std::filesystem;
using testing::lamp_data;
using testing::TemporaryFolder;

/// The result of reading a bag: an error, or the data.
struct Outcome {
  std::string error;
  std::string read;  // everything but the problems
  std::size_t problems = 0;
};

Outcome outcome_of(const fs::path& file) {
  Outcome outcome;
  try {
    const Mission mission = read_mission(file);
    ContentHasher hash;
    const auto pose = [&](const Eigen::Isometry3d& T) { hash.bytes(T.matrix().data(), 16 * sizeof(double)); };
    const auto information = [&](const Matrix6d& m) { hash.bytes(m.data(), 36 * sizeof(double)); };
    for (const Node& node : mission.graph.nodes()) {
      hash.integer(node.key).integer(static_cast<std::uint64_t>(node.stamp_ns));
      pose(node.pose);
    }
    for (const Edge& edge : mission.graph.edges()) {
      hash.integer(edge.from).integer(edge.to);
      pose(edge.T_from_to);
      information(edge.information);
    }
    for (const PriorFactor& prior : mission.graph.priors()) {
      hash.integer(prior.key);
      pose(prior.pose);
      information(prior.information);
    }
    for (const Key key : mission.scans->keys()) {
      hash.integer(key);
      try {
        for (const Eigen::Vector3f& p : mission.scans->load(key)->points) hash.bytes(p.data(), sizeof(p));
      } catch (const InputError&) {
        // A reported problem of the scans.
      }
    }
    for (const Robot& robot : mission.robots.all()) hash.text(robot.name);
    outcome.read = to_string(hash.finish());
    Problems problems = mission.problems;
    problems.add(mission.scans->problems());
    for (const Problem& problem : problems.all()) outcome.problems += problem.count;
  } catch (const Error& error) {
    outcome.error = error.what();
  }
  return outcome;
}

TEST_CASE("bags: a hundred cuts and a hundred flips of a byte", "[io][bag][damage]") {
  const TemporaryFolder folder;
  const std::string compression = GENERATE("none", "bz2", "lz4");
  CAPTURE(compression);
  if (!lamp_data("bags", folder / "d",
                 "--robots c --nodes 5 --points 12 --chunk 3000 --compression " + compression)) {
    return;
  }
  const std::string whole = read_file(folder / "d" / "rosbag" / "husky3.bag");
  const fs::path file = folder / "damaged.bag";
  const auto read = [&](const std::string& bytes) {
    write_file(file, bytes);
    return outcome_of(file);
  };
  const Outcome intact = read(whole);
  REQUIRE(intact.error.empty());
  REQUIRE(intact.problems == 0);

  Rng rng(11);
  for (int i = 0; i < 100; ++i) {
    const std::size_t size = rng.below(whole.size());
    const Outcome cut = read(whole.substr(0, size));
    CAPTURE(size);
    REQUIRE_FALSE(cut.error.empty());
    // An empty file has no marks to recognise.
    if (size >= 7) REQUIRE_THAT(cut.error, Contains("damaged.bag"));
  }

  std::size_t errors = 0, stated = 0, harmless = 0, other_values = 0;
  for (int i = 0; i < 100; ++i) {
    std::string bytes = whole;
    const std::size_t at = rng.below(bytes.size());
    const auto flip = static_cast<char>(1 + rng.below(255));
    bytes[at] = static_cast<char>(bytes[at] ^ flip);
    const Outcome flipped = read(bytes);
    CAPTURE(at, static_cast<int>(flip), flipped.error);
    if (!flipped.error.empty()) {
      ++errors;
    } else if (flipped.problems > 0) {
      ++stated;
    } else if (flipped.read == intact.read) {
      ++harmless;  // for example between the fields of a point
    } else {
      // An uncompressed bag has no checksums, so altered numbers of a message cannot be detected.
      REQUIRE(compression == "none");
      ++other_values;
    }
  }
  std::cerr << "flips of a byte, " << compression << ": " << errors << " errors, " << stated
            << " stated problems, " << harmless << " without effect, " << other_values << " other values\n";
  CHECK(errors + stated + harmless + other_values == 100);
  if (compression != "none") CHECK(errors + stated == 100);
}

TEST_CASE("bags: factors with altered numbers are read or refused", "[io][bag][damage]") {
  const TemporaryFolder folder;
  if (!lamp_data("factors", folder / "d", "--points 3")) return;
  const std::string whole = read_file(folder / "d" / "factors.bag");
  // Of the first message alone: that is where the factors are.
  const std::size_t begin = whole.find("uuid-u0"), end = whole.find("base1/lamp/keyed_scans");
  REQUIRE(begin < end);
  Rng rng(12);
  std::size_t errors = 0;
  for (int i = 0; i < 200; ++i) {
    std::string bytes = whole;
    const std::size_t at = begin + rng.below(std::min<std::size_t>(end - begin, 14000));
    // Half of them by eight bytes that are no number where they meet one.
    if (i % 2 == 0) {
      bytes.replace(at, 8, std::string("\x00\x00\x00\x00\x00\x00\xF8\x7F", 8));
    } else {
      bytes[at] = static_cast<char>(bytes[at] ^ static_cast<char>(1 + rng.below(255)));
    }
    write_file(folder / "damaged.bag", bytes);
    CAPTURE(i, at);
    const Outcome outcome = outcome_of(folder / "damaged.bag");  // every exception is an Error
    if (!outcome.error.empty()) ++errors;
  }
  std::cerr << "factors with altered numbers: " << errors << " of 200 bags are errors\n";
  CHECK(errors < 200);
}

TEST_CASE("bags: false sizes and offsets", "[io][bag][damage]") {
  const TemporaryFolder folder;
  if (!lamp_data("bags", folder / "d", "--robots c --nodes 3 --compression lz4")) return;
  const std::string whole = read_file(folder / "d" / "rosbag" / "husky3.bag");
  struct Change {
    std::string after;  // the last field of this name
    std::string value;
    std::string message;
  };
  const auto number = [](std::uint64_t value, std::size_t bytes) {
    std::string out;
    for (std::size_t i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i) & 255);
    return out;
  };
  const std::vector<Change> changes = {
      {"index_pos=", number(0, 8), "never closed"},
      {"index_pos=", number(1ull << 60, 8), "cut short"},
      {"index_pos=", number(20, 8), "within the bag's header"},
      {"conn_count=", number(9, 4), "damaged.bag: byte"},
      {"chunk_count=", number(0, 4), "after the end of the index"},
      {"chunk_count=", number(0xFFFFFFFF, 4), "damaged.bag: byte"},
      {"chunk_pos=", number(1ull << 40, 8), "the index lists a chunk at byte"},
      {"size=", number(0xFFFFFFFF, 4), "are not read"},
      {"size=", number(0x3FFFFFFF, 4), "compressed data are damaged"},
      {"compression=", "zip", "unknown compression \"zip\""},
  };
  for (const Change& change : changes) {
    CAPTURE(change.after, change.message);
    std::string bytes = whole;
    const std::size_t at = bytes.find(change.after);
    REQUIRE(at != std::string::npos);
    bytes.replace(at + change.after.size(), change.value.size(), change.value);
    write_file(folder / "damaged.bag", bytes);
    CHECK_THROWS_WITH(read_mission(folder / "damaged.bag"), Contains(change.message));
  }
  // A block of lz4 that is larger than any may be: the decoder itself would write beyond its buffer.
  std::string bytes = whole;
  const std::size_t frame = bytes.find("\x04\x22\x4D\x18");
  REQUIRE(frame != std::string::npos);
  bytes.replace(frame + 7, 4, number(0x00FFFFFF, 4));
  write_file(folder / "damaged.bag", bytes);
  CHECK_THROWS_WITH(read_mission(folder / "damaged.bag"), Contains("compressed data are damaged"));
}

TEST_CASE("ros messages: fields are found by the definition", "[io][bag][ros]") {
  const std::string definition =
      "# A comment = with a sign\n"
      "int32 KIND=3\n"
      "string NAME=any # text\n"
      "uint8 a\n"
      "Inner[] inner # of any number\n"
      "float32[2] pair\n"
      "time when\n"
      "string text\n"
      "================================================================================\n"
      "MSG: test_msgs/Inner\n"
      "int16 b\n"
      "string[] words\n";
  const ros1::Schema schema("test_msgs/Outer", definition);
  std::string bytes;
  const auto put = [&](auto value) {
    char raw[sizeof(value)];
    std::memcpy(raw, &value, sizeof(value));
    bytes.append(raw, sizeof(value));
  };
  const auto put_text = [&](const std::string& text) {
    put(static_cast<std::uint32_t>(text.size()));
    bytes += text;
  };
  put(static_cast<std::uint8_t>(200));
  put(std::uint32_t{2});
  put(std::int16_t{-5});
  put(std::uint32_t{2});
  put_text("one");
  put_text("");
  put(std::int16_t{6});
  put(std::uint32_t{0});
  put(1.5f);
  put(-2.5f);
  put(std::uint32_t{7});
  put(std::uint32_t{8});
  put_text("end");

  const ros1::Value message(schema, bytes);
  CHECK(message.at("a").integer() == 200);
  CHECK(message.at("inner").size() == 2);
  std::vector<std::int64_t> b;
  std::vector<std::string> words;
  message.at("inner").for_each([&](const ros1::Value& inner) {
    b.push_back(inner.at("b").integer());
    inner.at("words").for_each([&](const ros1::Value& word) { words.emplace_back(word.text()); });
  });
  CHECK(b == std::vector<std::int64_t>{-5, 6});
  CHECK(words == std::vector<std::string>{"one", ""});
  CHECK(message.at("pair").numbers() == std::vector<double>{1.5, -2.5});
  CHECK(message.at("pair").raw().size() == 8);
  CHECK(message.at("when").time_ns() == 7'000'000'008);
  CHECK(message.at("text").text() == "end");
  CHECK(message.has("text"));
  CHECK_FALSE(message.has("KIND"));
  CHECK_THROWS_WITH(message.at("c"), Contains("no field c in test_msgs/Outer"));
  CHECK_THROWS_AS(message.at("text").number(), InputError);
  CHECK_THROWS_AS(message.at("a").text(), InputError);
  CHECK_THROWS_AS(message.at("a").size(), InputError);

  for (std::size_t size = 0; size < bytes.size(); ++size) {
    CAPTURE(size);
    CHECK_THROWS_AS(ros1::Value(schema, std::string_view(bytes).substr(0, size)), InputError);
  }
  CHECK_THROWS_WITH(ros1::Value(schema, bytes + "x"), Contains("its definition needs"));
  // Counts that the bytes cannot hold, and that no sum may overflow.
  for (std::size_t at = 0; at + 4 <= bytes.size(); ++at) {
    std::string damaged = bytes;
    damaged.replace(at, 4, "\xFF\xFF\xFF\xFF");
    try {
      const ros1::Value value(schema, damaged);
      static_cast<void>(value.at("pair").numbers());
    } catch (const InputError&) {
    }
  }
}

TEST_CASE("ros messages: invalid definitions", "[io][bag][ros][error]") {
  const auto schema = [](const std::string& text) { return [text] { ros1::Schema("test_msgs/A", text); }; };
  const std::string line = std::string(80, '=') + "\nMSG: ";
  CHECK_THROWS_WITH(schema("Other o\n")(),
                    Contains("definition of test_msgs/A:1: type \"Other\" is not defined"));
  CHECK_THROWS_WITH(schema("uint8\n")(), Contains("is not a field"));
  CHECK_THROWS_WITH(schema("uint8 a b\n")(), Contains("is not a field"));
  CHECK_THROWS_WITH(schema("uint8[x] a\n")(), Contains("is not a type"));
  CHECK_THROWS_WITH(schema("uint8[ a\n")(), Contains("is not a type"));
  CHECK_THROWS_WITH(schema("uint8 a\n" + std::string(80, '=') + "\nnothing\n")(),
                    Contains("expected \"MSG:"));
  CHECK_THROWS_WITH(schema("B b\n" + line + "test_msgs/B\nB[] b\n")(),
                    Contains("test_msgs/B contains itself"));
  CHECK_THROWS_WITH(schema("uint64[99999999999999] a\n")(), Contains("is too large"));
  CHECK_THROWS_WITH(schema("B[4294967295] a\n" + line + "test_msgs/B\nfloat64[4294967295] b\n")(),
                    Contains("is too large"));
  CHECK_NOTHROW(schema("")());
  CHECK_NOTHROW(schema("B[4294967295] a\n" + line + "test_msgs/B\n")());
}

}  // namespace
}  // namespace loopwise::bag_damage_test
