// SPDX-License-Identifier: BSD-3-Clause
// Bags of ROS 2 that were cut short or altered, sizes that lie, and data that unpack to too much.
#include <cstring>

#include <loopwise/core/error.hpp>

#include "lamp_testing.hpp"

namespace loopwise::rosbag2_damage_test {
namespace {

namespace fs = std::filesystem;
using testing::rosbag2_data;
using testing::TemporaryFolder;

/// The error, or nothing if the mission was read with its scans. Anything but an Error goes through.
std::string error_of(const fs::path& file) {
  try {
    const Mission mission = read_mission(file);
    for (const Key key : mission.scans->keys()) {
      try {
        static_cast<void>(mission.scans->load(key));
      } catch (const InputError&) {
        // A stated problem of the scans.
      }
    }
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

TEST_CASE("rosbag2: a hundred cuts and two hundred flips of a byte", "[io][bag][rosbag2][damage]") {
  const TemporaryFolder folder;
  const std::string storage = GENERATE("mcap", "mcap --pack zstd", "mcap --pack lz4", "db3");
  CAPTURE(storage);
  if (!rosbag2_data("bags", folder / "d", "--robots c --nodes 5 --points 12 --storage " + storage)) return;
  const std::string ending = storage.substr(0, storage.find(' '));
  const std::string whole = read_file(folder / "d" / "rosbag" / ("husky3." + ending));
  const fs::path file = folder / ("damaged." + ending);
  const auto read = [&](const std::string& bytes) {
    write_file(file, bytes);
    return error_of(file);
  };
  REQUIRE(read(whole).empty());
  Rng rng(11);
  for (int i = 0; i < 100; ++i) {
    const std::size_t size = 20 + rng.below(whole.size() - 20);
    CAPTURE(size);
    CHECK_THAT(read(whole.substr(0, size)), Contains("damaged."));
  }
  std::size_t errors = 0;
  for (int i = 0; i < 200; ++i) {
    std::string bytes = whole;
    const std::size_t at = rng.below(bytes.size());
    bytes[at] = static_cast<char>(bytes[at] ^ static_cast<char>(1 + rng.below(255)));
    CAPTURE(at);
    const std::string error = read(bytes);
    if (!error.empty()) ++errors;
  }
  std::cerr << "flips of a byte, " << storage << ": " << errors << " of 200 are errors\n";
  CHECK(errors < 200);
}

TEST_CASE("rosbag2: false sizes are found before memory is allocated", "[io][bag][rosbag2][damage]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "d", "--robots c --nodes 3 --pack zstd")) return;
  const std::string whole = read_file(folder / "d" / "rosbag" / "husky3.mcap");
  const std::size_t header = 8 + 9 + 4 + 4 + 4 + 15;  // mark, head, profile "ros2", library "rosbag2_data.py"
  REQUIRE(whole[header] == '\6');                     // the first chunk
  const auto with = [&](std::size_t at, std::uint64_t value) {
    std::string bytes = whole;
    std::memcpy(&bytes[at], &value, sizeof(value));
    write_file(folder / "lying.mcap", bytes);
    return error_of(folder / "lying.mcap");
  };
  const std::string place = "lying.mcap: byte " + std::to_string(header) + ": ";
  CHECK_THAT(with(header + 1, ~std::uint64_t{0}), Contains(place + "a record of 18446744073709551615 bytes"));
  CHECK_THAT(with(header + 1, std::uint64_t{1} << 40), Contains("cut short"));
  CHECK_THAT(with(header + 9 + 16, std::uint64_t{1} << 40),
             Contains(place + "a chunk of 1099511627776 bytes"));
  CHECK_THAT(with(header + 9 + 16, 100), Contains(place) && Contains("more than the allowed 100 bytes"));
  CHECK_THAT(with(header + 9 + 16, 200'000'000), Contains("its header says 200000000"));
}

TEST_CASE("rosbag2: broken messages are counted or named with topic and row", "[io][bag][rosbag2][damage]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "d", "--robots c --nodes 4 --storage db3")) return;
  const fs::path file = folder / "d" / "rosbag" / "husky3.db3";
  const auto update = [&](const std::string& sql) {
    const std::string run =
        "import sqlite3; d = sqlite3.connect('" + file.string() + "'); d.execute('" + sql + "'); d.commit()";
    REQUIRE(std::system((std::string(testing::kPython) + " -c \"" + run + "\"").c_str()) == 0);
  };
  update("UPDATE messages SET data = substr(data, 1, 21) WHERE id = 1");
  const Mission mission = read_mission(file);
  CHECK(mission.problems.count("message cannot be read") == 1);
  for (const Problem& problem : mission.problems.all()) {
    if (problem.kind == "message cannot be read")
      CHECK_THAT(problem.example, Contains("husky3.db3: /husky3/lamp/") && Contains("are left"));
  }
  update("INSERT INTO messages (topic_id, timestamp, data) VALUES (77, 1, zeroblob(3))");
  CHECK(read_mission(file).problems.count("message of an unknown topic left out") == 1);
  update("UPDATE messages SET data = 5 WHERE id = 2");
  CHECK_THAT(error_of(file),
             Contains("husky3.db3: row 2 of messages, topic /husky3/lamp/") && Contains("has no data"));
  update("UPDATE messages SET timestamp = 1.5 WHERE id = 2");
  CHECK_THAT(error_of(file), Contains("row 2 of messages: timestamp is not a whole number"));
}

TEST_CASE("rosbag2: files that unpack to too much are refused", "[io][bag][rosbag2][damage]") {
  const TemporaryFolder folder;
  if (!rosbag2_data("bags", folder / "d", "--robots c --nodes 3")) return;
  // 256 MB of zeros in 8 kB.
  const std::string make = "import sys; sys.path.insert(0, '" + std::string(LOOPWISE_SOURCE_DIR) +
                           "/tests/io'); import rosbag2_data as d; open('" +
                           (folder / "bomb.mcap.zstd").string() + "', 'wb').write(d.zstd(b'\\\\0' * 2**28))";
  REQUIRE(std::system((std::string(testing::kPython) + " -c \"" + make + "\"").c_str()) == 0);
  CHECK_THAT(error_of(folder / "bomb.mcap.zstd"),
             Contains("bomb.mcap.zstd: unpacks to more than 1000 times"));
  testing::write_text(folder / "cut.db3.zstd", read_file(folder / "bomb.mcap.zstd").substr(0, 30));
  CHECK_THAT(error_of(folder / "cut.db3.zstd"), Contains("cut.db3.zstd") && Contains("cut short"));
}

}  // namespace
}  // namespace loopwise::rosbag2_damage_test
