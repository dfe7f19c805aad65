// SPDX-License-Identifier: BSD-3-Clause
#include "mcap_writer.hpp"

#include <algorithm>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kChunkBytes = 1 << 20;
const std::string kMagic("\x89MCAP0\r\n", 8);

enum Opcode : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0B,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

std::string record(std::uint8_t opcode, const std::string& content) {
  McapBytes bytes;
  bytes.number(opcode).number(static_cast<std::uint64_t>(content.size())).raw(content);
  return bytes.text();
}

/// A map of numbers, preceded by its length in bytes.
std::string map_text(const std::map<std::uint16_t, std::uint64_t>& map) {
  McapBytes entries;
  for (const auto& [key, value] : map) entries.number(key).number(value);
  McapBytes bytes;
  return bytes.string(entries.text()).text();
}

}  // namespace

McapWriter::McapWriter(std::ostream& out, const std::string& library) : out_(out) {
  write(kMagic);
  McapBytes header;
  write_record(kHeader, header.string("ros2").string(library).text());
}

void McapWriter::write(const std::string& bytes) {
  out_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  if (!out_) throw IoError("the MCAP file", "cannot be written: is the disk full?");
  offset_ += bytes.size();
}

void McapWriter::write_record(std::uint8_t opcode, const std::string& content) {
  write(record(opcode, content));
}

std::uint16_t McapWriter::channel(const std::string& topic, const std::string& type,
                                  const std::string& definition) {
  const auto [schema, is_new] = schema_ids_.emplace(type, schemas_.size() + 1);  // 0 means: no schema
  if (is_new) {
    McapBytes content;
    schemas_.push_back(
        content.number(schema->second).string(type).string("ros2msg").string(definition).text());
    chunk_.raw(record(kSchema, schemas_.back()));
  }
  const auto id = static_cast<std::uint16_t>(channels_.size());
  McapBytes content;
  channels_.push_back(content.number(id)
                          .number(schema->second)
                          .string(topic)
                          .string("cdr")
                          .number(std::uint32_t{0})  // no metadata
                          .text());
  chunk_.raw(record(kChannel, channels_.back()));
  return id;
}

void McapWriter::add(std::uint16_t channel, std::int64_t time_ns, const std::string& message) {
  if (time_ns < 0) throw InputError("MCAP has no times before 1970");
  const auto time = static_cast<std::uint64_t>(time_ns);
  const bool first = chunk_messages_.empty();
  chunk_begin_ns_ = first ? time : std::min(chunk_begin_ns_, time);
  chunk_end_ns_ = first ? time : std::max(chunk_end_ns_, time);
  begin_ns_ = messages_ == 0 ? time : std::min(begin_ns_, time);
  end_ns_ = messages_ == 0 ? time : std::max(end_ns_, time);
  chunk_messages_[channel].emplace_back(time, chunk_.size());
  const auto sequence = static_cast<std::uint32_t>(counts_[channel]++);
  McapBytes content;
  content.number(channel).number(sequence).number(time).number(time).raw(message);
  chunk_.raw(record(kMessage, content.text()));
  ++messages_;
  if (chunk_.size() >= kChunkBytes) write_chunk();
}

void McapWriter::write_chunk() {
  if (chunk_.size() == 0) return;
  ChunkIndex index{};
  index.begin_ns = chunk_begin_ns_;
  index.end_ns = chunk_end_ns_;
  index.offset = offset_;
  index.size = chunk_.size();
  McapBytes content;
  content.number(chunk_begin_ns_).number(chunk_end_ns_).number(index.size);
  content.number(std::uint32_t{0}).string("");  // neither checksum nor compression
  content.number(index.size).raw(chunk_.text());
  write_record(kChunk, content.text());
  index.length = offset_ - index.offset;
  const std::uint64_t indexes_begin = offset_;
  for (auto& [channel, messages] : chunk_messages_) {
    std::stable_sort(messages.begin(), messages.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    McapBytes entries;
    for (const auto& [time, offset] : messages) entries.number(time).number(offset);
    McapBytes message_index;
    index.indexes[channel] = offset_;
    write_record(kMessageIndex, message_index.number(channel).string(entries.text()).text());
  }
  index.index_length = offset_ - indexes_begin;
  chunks_.push_back(std::move(index));
  chunk_.clear();
  chunk_messages_.clear();
}

std::string McapWriter::statistics() const {
  McapBytes bytes;
  bytes.number(messages_).number(static_cast<std::uint16_t>(schemas_.size()));
  bytes.number(static_cast<std::uint32_t>(channels_.size()));
  bytes.number(std::uint32_t{0}).number(std::uint32_t{0});  // attachments, metadata
  bytes.number(static_cast<std::uint32_t>(chunks_.size())).number(begin_ns_).number(end_ns_);
  return bytes.raw(map_text(counts_)).text();
}

void McapWriter::finish() {
  write_chunk();
  write_record(kDataEnd, McapBytes().number(std::uint32_t{0}).text());
  const std::uint64_t summary_begin = offset_;
  std::string offsets;
  const auto group = [&](Opcode opcode, const std::vector<std::string>& contents) {
    if (contents.empty()) return;
    const std::uint64_t begin = offset_;
    for (const std::string& content : contents) write_record(opcode, content);
    McapBytes place;
    place.number(static_cast<std::uint8_t>(opcode)).number(begin).number(offset_ - begin);
    offsets += record(kSummaryOffset, place.text());
  };
  group(kSchema, schemas_);
  group(kChannel, channels_);
  group(kStatistics, {statistics()});
  std::vector<std::string> chunks;
  for (const ChunkIndex& chunk : chunks_) {
    McapBytes bytes;
    bytes.number(chunk.begin_ns).number(chunk.end_ns).number(chunk.offset).number(chunk.length);
    bytes.raw(map_text(chunk.indexes)).number(chunk.index_length).string("");
    chunks.push_back(bytes.number(chunk.size).number(chunk.size).text());
  }
  group(kChunkIndex, chunks);
  const std::uint64_t offsets_begin = offset_;
  write(offsets);
  McapBytes footer;
  footer.number(summary_begin).number(offsets_begin).number(std::uint32_t{0});  // no checksum
  write_record(kFooter, footer.text());
  write(kMagic);
}

}  // namespace loopwise
