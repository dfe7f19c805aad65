// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// MCAP files (https://mcap.dev/spec, version 0) with ROS 2 messages.
#pragma once

#include <cstdint>
#include <map>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

namespace loopwise {

/// Appends numbers in little-endian order and strings with their lengths, as MCAP stores them.
class McapBytes {
 public:
  template <class T>
  McapBytes& number(T value) {
    auto bits = static_cast<std::uint64_t>(value);
    for (std::size_t i = 0; i < sizeof(T); ++i, bits >>= 8) text_ += static_cast<char>(bits & 0xFF);
    return *this;
  }
  McapBytes& string(const std::string& value) {
    number(static_cast<std::uint32_t>(value.size()));
    text_ += value;
    return *this;
  }
  McapBytes& raw(const std::string& value) {
    text_ += value;
    return *this;
  }
  [[nodiscard]] const std::string& text() const { return text_; }
  [[nodiscard]] std::size_t size() const { return text_.size(); }
  void clear() { text_.clear(); }

 private:
  std::string text_;
};

/// Writes messages in chunks with an index, so that viewers can jump in time. Chunks are not compressed.
class McapWriter {
 public:
  /// Begins the file. `out` must be at its beginning and outlive the writer.
  McapWriter(std::ostream& out, const std::string& library);
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  /// A topic of CDR messages of a ROS 2 type: "nav_msgs/msg/Path" and its definition with those of its parts.
  /// \returns the number for add()
  std::uint16_t channel(const std::string& topic, const std::string& type, const std::string& definition);
  /// A message. Times should not decrease, or viewers load more than they show.
  void add(std::uint16_t channel, std::int64_t time_ns, const std::string& message);
  /// Ends the file. To be called once.
  void finish();

  [[nodiscard]] std::uint64_t messages() const { return messages_; }

 private:
  struct ChunkIndex {
    std::uint64_t begin_ns, end_ns, offset, length, index_length, size;
    std::map<std::uint16_t, std::uint64_t> indexes;  // by channel: offset of its message index
  };

  void write(const std::string& bytes);
  void write_record(std::uint8_t opcode, const std::string& content);
  void write_chunk();
  [[nodiscard]] std::string statistics() const;

  std::ostream& out_;
  std::uint64_t offset_ = 0;
  std::uint64_t messages_ = 0;
  std::map<std::string, std::uint16_t> schema_ids_;
  std::vector<std::string> schemas_, channels_;  // contents of their records
  std::map<std::uint16_t, std::uint64_t> counts_;
  std::vector<ChunkIndex> chunks_;
  McapBytes chunk_;
  std::map<std::uint16_t, std::vector<std::pair<std::uint64_t, std::uint64_t>>> chunk_messages_;
  std::uint64_t chunk_begin_ns_ = 0, chunk_end_ns_ = 0, begin_ns_ = 0, end_ns_ = 0;
};

}  // namespace loopwise
