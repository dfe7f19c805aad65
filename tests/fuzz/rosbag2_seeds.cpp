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
std::string number(T value) {
  std::string out;
  for (std::size_t i = 0; i < sizeof(T); ++i)
    out += static_cast<char>(static_cast<std::uint64_t>(value) >> (8 * i) & 255);
  return out;
}

std::string text(const std::string& value) {
  return number(static_cast<std::uint32_t>(value.size())) + value;
}

std::string record(int op, const std::string& content) {
  return static_cast<char>(op) + number(std::uint64_t{content.size()}) + content;
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
      records += record(3, number(id) + text(type.name) + text("ros1msg") + text(type.definition));
      records +=
          record(4, number(id) + number(id) + text(type.topic) + text("ros1") + number(std::uint32_t{0}));
    }
    records += record(5, number(id) + number(std::uint32_t{0}) + number(stamp_of(message)) +
                             number(stamp_of(message)) + message.bytes);
  }
  if (compression != "none") {
    const std::string data = packed(compression, records);
    records = record(6, number(std::uint64_t{0}) + number(std::uint64_t{0}) +
                            number(std::uint64_t{records.size()}) + number(std::uint32_t{0}) +
                            text(compression) + number(std::uint64_t{data.size()}) + data);
  }
  const std::string mark("\x89MCAP0\r\n", 8);
  return mark + record(1, text("ros1") + text("")) + records + record(15, number(std::uint32_t{0})) +
         record(2, std::string(20, '\0')) + mark;
}

std::string db3(const std::vector<TypedMessage>& messages) {
  const auto file = scratch() / "seed.db3";
  std::filesystem::remove(file);
  sqlite3* database = nullptr;
  const auto run = [&](const std::string& sql) {
    if (sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK)
      throw std::runtime_error(sql + ": " + sqlite3_errmsg(database));
  };
  if (sqlite3_open(file.c_str(), &database) != SQLITE_OK) throw std::runtime_error("no database");
  run("PRAGMA page_size = 512; CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);"
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
    std::string hex;
    for (const char c : message.bytes) {
      constexpr char kDigits[] = "0123456789abcdef";
      (hex += kDigits[static_cast<unsigned char>(c) >> 4]) += kDigits[static_cast<unsigned char>(c) & 15];
    }
    run("INSERT INTO messages (topic_id, timestamp, data) VALUES (" + std::to_string(message.type) + ", " +
        std::to_string(stamp_of(message)) + ", x'" + hex + "')");
  }
  sqlite3_close(database);
  return read_file(file);
}

}  // namespace loopwise::fuzz
