// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <optional>

#include <loopwise/core/error.hpp>

#include "decompress.hpp"
#include "raw_file.hpp"
#include "rosbag2.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
enum McapOp : unsigned char {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kStatistics = 0x0b,
};
constexpr std::size_t kRecordHead = 9;                         // kind, length
constexpr std::size_t kMessageHead = 22;                       // channel, sequence, two times
constexpr std::size_t kLargestRecord = std::size_t{16} << 20;  // of schemas and channels
constexpr std::uint32_t kNoChunk = std::numeric_limits<std::uint32_t>::max();

/// Reads little-endian numbers and texts from the front of a record.
class Fields {
 public:
  explicit Fields(std::string_view bytes) : rest_(bytes) {}

  std::string_view bytes(std::uint64_t size) {
    if (size > rest_.size()) {
      throw InputError("a field of " + std::to_string(size) + " bytes, " + std::to_string(rest_.size()) +
                       " are left of the record");
    }
    const std::string_view out = rest_.substr(0, static_cast<std::size_t>(size));
    rest_.remove_prefix(out.size());
    return out;
  }
  template <class T>
  T number() {
    T value = 0;
    const std::string_view in = bytes(sizeof(T));
    for (std::size_t i = sizeof(T); i-- > 0;)
      value = static_cast<T>(static_cast<std::uint64_t>(value) << 8 | static_cast<unsigned char>(in[i]));
    return value;
  }
  std::string text() { return std::string(bytes(number<std::uint32_t>())); }
  [[nodiscard]] std::size_t left() const { return rest_.size(); }

 private:
  std::string_view rest_;
};

/// CRC-32 as in zip and PNG.
std::uint32_t crc32(std::string_view bytes) {
  static const std::array<std::uint32_t, 256> table = [] {
    std::array<std::uint32_t, 256> out{};
    for (std::uint32_t i = 0; i < 256; ++i) {
      out[i] = i;
      for (int bit = 0; bit < 8; ++bit) out[i] = out[i] >> 1 ^ ((out[i] & 1) != 0 ? 0xEDB88320u : 0u);
    }
    return out;
  }();
  std::uint32_t crc = 0xFFFFFFFFu;
  for (const char byte : bytes) crc = table[(crc ^ static_cast<unsigned char>(byte)) & 255] ^ crc >> 8;
  return ~crc;
}

std::string inflate(const std::string& compression, std::string_view data, std::size_t size) {
  if (compression.empty()) return std::string(data);
  if (compression == "zstd") return inflate_zstd(data, size);
  if (compression == "lz4") return inflate_lz4(data, size);
  throw InputError("unknown compression " + text::quoted(compression) + ", expected zstd or lz4");
}

struct Schema {
  std::string name, encoding, definition;
};

struct MessageHead {
  std::uint16_t channel = 0;
  std::int64_t stamp_ns = 0;
};

MessageHead message_head(Fields fields) {
  MessageHead head;
  head.channel = fields.number<std::uint16_t>();
  static_cast<void>(fields.number<std::uint32_t>());
  const auto stamp = fields.number<std::uint64_t>();
  static_cast<void>(fields.number<std::uint64_t>());
  if (stamp > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()))
    throw InputError("a message's time exceeds 63 bits");
  head.stamp_ns = static_cast<std::int64_t>(stamp);
  return head;
}

class Mcap : public Storage {
 public:
  Mcap(const NumberedFile& file, const Opening& opening)
      : bag_(file.number), name_(file.file.name), file_(file.file.path), known_(opening.known) {
    walk(opening);
    if (expected_ && *expected_ != seen_) {
      opening.problems.add_altered("messages missing from the summary",
                                   name_ + ": the summary counts " + std::to_string(*expected_) +
                                       " messages, the file has " + std::to_string(seen_));
    }
    schemas_.clear();
  }

  std::vector<Entry> index(const std::vector<bool>& wanted) override { return sorted(entries_, wanted); }

  std::string read(const Entry& entry) override {
    std::string bytes;
    try {
      if (entry.offset == kNoChunk) {
        bytes = contents_of(record(entry.place, file_.size()));
      } else {
        load_chunk(entry.place);
        Fields fields(chunk_);
        static_cast<void>(fields.bytes(entry.offset + 1));
        bytes = contents_of(fields.bytes(fields.number<std::uint64_t>()));
      }
      return unpacked_message(std::move(bytes));
    } catch (const InputError& error) {
      throw InputError(name_ + ": byte " + std::to_string(entry.place) + ": a message of " +
                       connections_[entry.connection].topic + ": " + error.what());
    }
  }

 private:
  [[noreturn]] void fail(std::uint64_t at, const std::string& why) const {
    throw InputError(name_ + ": byte " + std::to_string(at) + ": " + why);
  }
  [[noreturn]] void cut_short(std::uint64_t at, const std::string& why) const {
    fail(at, why +
                 ": the recording is cut short or damaged; 'mcap recover' saves the "
                 "remaining part");
  }

  /// The message in a record. The record was found complete when the file was opened.
  static std::string contents_of(std::string_view record) {
    Fields fields(record);
    static_cast<void>(fields.bytes(kMessageHead));
    return std::string(fields.bytes(fields.left()));
  }

  /// Length of the record's contents, which must end before `end`.
  std::size_t record_size(std::uint64_t at, std::uint64_t end, unsigned char& op) const {
    if (at > end || end - at < kRecordHead) cut_short(at, "the file ends without a closing record");
    std::string head;
    file_.read(at, kRecordHead, head);
    op = static_cast<unsigned char>(head[0]);
    const auto size = Fields(std::string_view(head).substr(1)).number<std::uint64_t>();
    if (size > end - at - kRecordHead) {
      cut_short(at, "a record of " + std::to_string(size) + " bytes, " +
                        std::to_string(end - at - kRecordHead) + " are left");
    }
    return static_cast<std::size_t>(size);
  }

  [[nodiscard]] std::string record(std::uint64_t at, std::uint64_t end) const {
    unsigned char op = 0;
    const std::size_t size = record_size(at, end, op);
    if (size > kLargestPiece) throw InputError("a record of " + std::to_string(size) + " bytes is too large");
    std::string out;
    file_.read(at + kRecordHead, size, out);
    return out;
  }

  void walk(const Opening& opening) {
    std::string mark;
    if (file_.size() < kMagic.size()) cut_short(0, "the file ends within its first mark");
    file_.read(0, kMagic.size(), mark);
    if (mark != kMagic) fail(0, "is not an MCAP recording");
    std::uint64_t at = kMagic.size();
    for (unsigned char op = 0; op != kFooter;) {
      if (opening.stop.stop_requested()) throw StoppedError("reading " + name_ + " was stopped");
      const std::size_t size = record_size(at, file_.size(), op);
      try {
        scan_record(op, at, size);
      } catch (const InputError& error) {
        fail(at, error.what());
      }
      at += kRecordHead + size;
      if (opening.progress) {
        opening.progress({"checking " + name_, static_cast<std::size_t>(at >> 20),
                          static_cast<std::size_t>(file_.size() >> 20), "MB"});
      }
    }
    if (file_.size() - at < kMagic.size()) cut_short(at, "the closing mark is missing");
    file_.read(at, kMagic.size(), mark);
    if (mark != kMagic) cut_short(at, "the closing mark is missing");
    if (file_.size() - at > kMagic.size()) fail(at + kMagic.size(), "data after the closing mark");
  }

  /// Processes a record of the file.
  void scan_record(unsigned char op, std::uint64_t at, std::size_t size) {
    std::string bytes;
    switch (op) {
      case 0:
        throw InputError("a record of kind 0: the file is damaged");
      case kChunk:
        scan_chunk(at);
        return;
      case kMessage:
        if (size > kLargestPiece)
          throw InputError("a message of " + std::to_string(size) + " bytes is too large");
        file_.read(at + kRecordHead, std::min(size, kMessageHead), bytes);
        add_message(bytes, {0, at, kNoChunk, 0});
        return;
      case kHeader:
      case kSchema:
      case kChannel:
      case kStatistics:
        if (size > kLargestRecord)
          throw InputError("a record of " + std::to_string(size) + " bytes is too large");
        file_.read(at + kRecordHead, size, bytes);
        add_description(op, bytes);
        return;
      default:  // attachments, indexes and records of later versions
        return;
    }
  }

  void add_description(unsigned char op, std::string_view bytes) {
    Fields fields(bytes);
    if (op == kStatistics) expected_ = fields.number<std::uint64_t>();
    if (op == kSchema) {
      const auto id = fields.number<std::uint16_t>();
      Schema schema;
      schema.name = fields.text();
      schema.encoding = fields.text();
      schema.definition = fields.text();
      if (id == 0) throw InputError("a schema with id 0");
      schemas_[id] = std::move(schema);
    }
    if (op != kChannel) return;
    const auto id = fields.number<std::uint16_t>(), schema_id = fields.number<std::uint16_t>();
    const std::string topic = fields.text(), encoding = fields.text();
    if (channels_.count(id) != 0) {  // repeated in every chunk that uses it, and in the summary
      const Connection& known = connections_[channels_[id]];
      if (known.topic != topic || known.encoding_name != encoding)
        throw InputError("channel " + std::to_string(id) + " is defined twice with different contents");
      return;
    }
    const auto schema = schemas_.find(schema_id);
    if (schema_id != 0 && schema == schemas_.end()) {
      throw InputError("channel " + text::quoted(topic) + " has schema " + std::to_string(schema_id) +
                       ", which is missing");
    }
    const Schema described = schema_id == 0 ? Schema() : schema->second;
    channels_[id] = connections_.size();
    connections_.push_back(
        rosbag2_connection(bag_, topic, described.name, encoding, described.encoding, described.definition));
  }

  void add_message(std::string_view bytes, Entry entry) {
    const MessageHead head = message_head(Fields(bytes));
    const auto channel = channels_.find(head.channel);
    if (channel == channels_.end())
      throw InputError("a message of channel " + std::to_string(head.channel) + ", which is missing");
    ++seen_;
    Connection& connection = connections_[channel->second];
    ++connection.messages;
    if (!known_(connection.type)) return;
    if (entries_.size() == kMostMessages)
      throw InputError("more than " + std::to_string(kMostMessages) + " messages: split the recording");
    entry.stamp_ns = head.stamp_ns;
    entry.connection = static_cast<std::uint32_t>(channel->second);
    entries_.push_back(entry);
  }

  /// Loads the chunk at this position. \throws InputError without a position
  void load_chunk(std::uint64_t at) {
    if (chunk_at_ == at) return;
    chunk_at_.reset();
    const std::string bytes = record(at, file_.size());
    Fields fields(bytes);
    static_cast<void>(fields.bytes(16));  // the times of its messages, which each message has as well
    const auto size = fields.number<std::uint64_t>();
    const auto crc = fields.number<std::uint32_t>();
    const std::string compression = fields.text();
    const std::string_view data = fields.bytes(fields.number<std::uint64_t>());
    if (size > kLargestPiece) throw InputError("a chunk of " + std::to_string(size) + " bytes is too large");
    chunk_ = inflate(compression, data, static_cast<std::size_t>(size));
    if (chunk_.size() != size) {
      throw InputError("a chunk of " + std::to_string(chunk_.size()) + " bytes, its header says " +
                       std::to_string(size));
    }
    if (crc != 0 && crc32(chunk_) != crc) throw InputError("the checksum of a chunk is wrong");
    chunk_at_ = at;
  }

  void scan_chunk(std::uint64_t at) {
    load_chunk(at);
    const std::string_view all = chunk_;
    for (std::size_t offset = 0; offset < all.size();) {
      try {
        Fields fields(all.substr(offset));
        const auto op = fields.number<unsigned char>();
        const std::string_view bytes = fields.bytes(fields.number<std::uint64_t>());
        if (op == kMessage) add_message(bytes, {0, at, static_cast<std::uint32_t>(offset), 0});
        if (op == kSchema || op == kChannel) add_description(op, bytes);
        offset = all.size() - fields.left();
      } catch (const InputError& error) {
        throw InputError("chunk, byte " + std::to_string(offset) + ": " + error.what());
      }
    }
  }

  std::size_t bag_;
  std::string name_;
  RawFile file_;
  BagSet::Known known_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, std::size_t> channels_;  // number in connections_
  std::vector<Entry> entries_;
  std::uint64_t seen_ = 0;
  std::optional<std::uint64_t> expected_;  // number of messages according to the summary
  std::optional<std::uint64_t> chunk_at_;  // position of the chunk whose contents are in chunk_
  std::string chunk_;
};

}  // namespace

std::unique_ptr<Storage> open_mcap(const NumberedFile& file, const Opening& opening) {
  return std::make_unique<Mcap>(file, opening);
}

}  // namespace loopwise::bags
