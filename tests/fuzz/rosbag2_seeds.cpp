// SPDX-License-Identifier: BSD-3-Clause
#include "rosbag2_seeds.hpp"

#include <lz4frame.h>
#include <sqlite3.h>
#include <zstd.h>

#include <filesystem>
#include <set>
#include <stdexcept>

#include <loopwise/io/atomic_file.hpp>

#include "target.hpp"

namespace loopwise::fuzz {
namespace {

template <class T>
std::string little_endian(T value) {
  std::string out;
  for (std::size_t i = 0; i < sizeof(T); ++i)
    out += static_cast<char>(static_cast<std::uint64_t>(value) >> (8 * i) & 255);
  return out;
}

std::string text(const std::string& value) {
  return little_endian(static_cast<std::uint32_t>(value.size())) + value;
}

std::string record(int op, const std::string& content) {
  return static_cast<char>(op) + little_endian(std::uint64_t{content.size()}) + content;
}

std::string packed(const std::string& compression, const std::string& bytes) {
  if (compression.empty()) return bytes;
  std::string out(ZSTD_compressBound(bytes.size()) + LZ4F_compressFrameBound(bytes.size(), nullptr), '\0');
  out.resize(compression == "zstd"
                 ? ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 1)
                 : LZ4F_compressFrame(out.data(), out.size(), bytes.data(), bytes.size(), nullptr));
  return out;
}

std::uint64_t stamp_of(const TypedMessage& message) {
  return (std::uint64_t{kBagStart} + message.second) * 1'000'000'000;
}

}  // namespace

std::string mcap(const std::vector<TypedMessage>& messages, const std::string& compression) {
  std::string records;
  std::set<std::size_t> described;
  for (const TypedMessage& message : messages) {
    const auto id = static_cast<std::uint16_t>(message.type + 1);
    const MessageType& type = message_types()[message.type];
    if (described.insert(message.type).second) {
      records += record(3, little_endian(id) + text(type.name) + text("ros1msg") + text(type.definition));
      records += record(4, little_endian(id) + little_endian(id) + text(type.topic) + text("ros1") +
                               little_endian(std::uint32_t{0}));
    }
    records +=
        record(5, little_endian(id) + little_endian(std::uint32_t{0}) + little_endian(stamp_of(message)) +
                      little_endian(stamp_of(message)) + message.bytes);
  }
  if (compression != "none") {
    const std::string data = packed(compression, records);
    records = record(6, little_endian(std::uint64_t{0}) + little_endian(std::uint64_t{0}) +
                            little_endian(std::uint64_t{records.size()}) + little_endian(std::uint32_t{0}) +
                            text(compression) + little_endian(std::uint64_t{data.size()}) + data);
  }
  const std::string mark("\x89MCAP0\r\n", 8);
  return mark + record(1, text("ros1") + text("")) + records + record(15, little_endian(std::uint32_t{0})) +
         record(2, std::string(20, '\0')) + mark;
}

namespace {

std::string hex_of(std::string_view bytes) {
  constexpr char kDigits[] = "0123456789abcdef";
  std::string hex;
  for (const char c : bytes)
    (hex += kDigits[static_cast<unsigned char>(c) >> 4]) += kDigits[static_cast<unsigned char>(c) & 15];
  return hex;
}

/// The file of a database that is filled by `fill(run)`, where run() executes SQL.
template <class Fill>
std::string database(Fill&& fill) {
  const auto file = scratch() / "seed.db3";
  std::filesystem::remove(file);
  sqlite3* made = nullptr;
  const auto run = [&](const std::string& sql) {
    if (sqlite3_exec(made, sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK)
      throw std::runtime_error(sql + ": " + sqlite3_errmsg(made));
  };
  if (sqlite3_open(file.c_str(), &made) != SQLITE_OK) throw std::runtime_error("no database");
  run("PRAGMA page_size = 512");
  fill(run);
  sqlite3_close(made);
  return read_file(file);
}

template <class Number>
std::string raw(const std::vector<Number>& numbers) {
  return {reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(Number)};
}

/// A block that zlib stores as it is, and the size and type that RTAB-Map writes behind it.
std::string stored_matrix(const std::string& bytes, std::int32_t columns, std::int32_t type) {
  const auto size = static_cast<unsigned>(bytes.size());
  std::uint32_t a = 1, b = 0;
  for (const char c : bytes) {
    a = (a + static_cast<unsigned char>(c)) % 65521;
    b = (b + a) % 65521;
  }
  std::string out = "\x78\x01\x01";
  for (const unsigned part : {size & 255, size >> 8, ~size & 255, ~size >> 8 & 255})
    out += static_cast<char>(part);
  out += bytes;
  for (const std::uint32_t part : {b >> 8, b & 255, a >> 8, a & 255}) out += static_cast<char>(part);
  return out + raw<std::int32_t>({1, columns, type});
}

}  // namespace

std::string db3(const std::vector<TypedMessage>& messages) {
  return database([&](const auto& run) {
    run("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data);"
        "CREATE TABLE message_definitions(topic_type, encoding, encoded_message_definition);");
    std::set<std::size_t> described;
    for (const TypedMessage& message : messages) {
      if (described.insert(message.type).second) {
        const std::string name = message_types()[message.type].name;
        run("INSERT INTO topics VALUES (" + std::to_string(message.type) + ", '" +
            message_types()[message.type].topic + "', '" + name +
            "', 'ros1'); INSERT INTO message_definitions VALUES ('" + name + "', 'ros1msg', '" +
            message_types()[message.type].definition + "')");
      }
      run("INSERT INTO messages (topic_id, timestamp, data) VALUES (" + std::to_string(message.type) + ", " +
          std::to_string(stamp_of(message)) + ", x'" + hex_of(message.bytes) + "')");
    }
  });
}

std::string rtabmap_database() {
  return database([&](const auto& run) {
    run("CREATE TABLE Node(id INTEGER PRIMARY KEY, map_id, weight, stamp, pose, ground_truth_pose);"
        "CREATE TABLE Data(id INTEGER PRIMARY KEY, scan, scan_info);"
        "CREATE TABLE Link(from_id, to_id, type, information_matrix, transform);"
        "CREATE TABLE Admin(version, opt_ids, opt_poses);");
    const auto pose = [](float x) { return raw<float>({1, 0, 0, x, 0, 1, 0, 0, 0, 0, 1, 0}); };
    std::vector<double> information(36, 0.0);
    for (std::size_t i = 0; i < 6; ++i) information[7 * i] = 100.0;
    const auto blob = [](const std::string& bytes) { return "x'" + hex_of(bytes) + "'"; };
    std::string poses;
    for (int id = 1; id <= 3; ++id) {
      const std::string key = std::to_string(id), at = pose(static_cast<float>(id));
      run("INSERT INTO Node VALUES (" + key + ", 0, 0, " + key + ".5, " + blob(at) + ", " + blob(at) + ")");
      const std::string points = raw<float>({1, 2, 3, 0.5F, 4, 5, 6, 0.5F});
      run("INSERT INTO Data VALUES (" + key + ", " + blob(stored_matrix(points, 2, 29)) + ", " +
          blob(raw<float>({6, 0, 80, 0, 0, 0, 0}) + pose(0)) + ")");
      poses += at;
      if (id == 1) continue;
      for (const int to : {id - 1, id == 3 ? 1 : 0}) {
        if (to > 0)
          run("INSERT INTO Link VALUES (" + std::to_string(to) + ", " + key + ", " +
              (to == id - 1 ? "0, " : "1, ") + blob(raw(information)) + ", " +
              blob(pose(static_cast<float>(id - to))) + ")");
      }
    }
    run("INSERT INTO Admin VALUES ('0.21.4', " + blob(stored_matrix(raw<std::int32_t>({1, 2, 3}), 3, 4)) +
        ", " + blob(stored_matrix(poses, 36, 5)) + ")");
  });
}

}  // namespace loopwise::fuzz
