// SPDX-License-Identifier: BSD-3-Clause
#include "bag_check.hpp"

#include <algorithm>
#include <map>
#include <tuple>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>

#include "raw_file.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMagic = "#ROSBAG V2.0\n";
enum Op : unsigned char {
  kMessageData = 0x02,
  kFileHeader = 0x03,
  kIndexData = 0x04,
  kChunk = 0x05,
  kChunkInfo = 0x06,
  kConnection = 0x07,
};

/// Headers are short, except that of a connection, which contains a message definition.
constexpr std::size_t kLargestHeader = std::size_t{16} << 20;
constexpr std::size_t kIndexEntry = 12, kCountEntry = 8;

template <class T>
T load_little_endian(std::string_view bytes) {
  T value = 0;
  for (std::size_t i = sizeof(T); i-- > 0;)
    value = static_cast<T>(value << 8 | static_cast<unsigned char>(bytes[i]));
  return value;
}

/// The fields of a record's header: "name=value", each after its length.
class Header {
 public:
  /// \throws InputError without a place
  explicit Header(std::string_view bytes) {
    while (!bytes.empty()) {
      if (bytes.size() < 4) throw InputError("a header field is cut short");
      const std::size_t size = load_little_endian<std::uint32_t>(bytes);
      bytes.remove_prefix(4);
      if (size > bytes.size()) {
        throw InputError("a header field of " + std::to_string(size) + " bytes, " +
                         std::to_string(bytes.size()) + " are left of the header");
      }
      const std::string_view field = bytes.substr(0, size);
      bytes.remove_prefix(size);
      const std::size_t equals = field.find('=');
      if (equals == std::string_view::npos || equals == 0) throw InputError("a header field without name");
      if (!fields_.emplace(std::string(field.substr(0, equals)), std::string(field.substr(equals + 1)))
               .second) {
        throw InputError("header field " + text::quoted(field.substr(0, equals)) + " appears twice");
      }
    }
  }

  [[nodiscard]] const std::string& text(const char* name) const {
    const auto found = fields_.find(name);
    if (found == fields_.end()) throw InputError("header field " + std::string(name) + " is missing");
    return found->second;
  }
  [[nodiscard]] std::string text_or_none(const char* name) const {
    const auto found = fields_.find(name);
    return found == fields_.end() ? std::string() : found->second;
  }
  template <class T>
  [[nodiscard]] T number(const char* name) const {
    const std::string& value = text(name);
    if (value.size() != sizeof(T)) {
      throw InputError("header field " + std::string(name) + " has " + std::to_string(value.size()) +
                       " bytes, must have " + std::to_string(sizeof(T)));
    }
    return load_little_endian<T>(value);
  }
  [[nodiscard]] unsigned char op() const { return number<unsigned char>("op"); }
  [[nodiscard]] bool operator==(const Header& other) const { return fields_ == other.fields_; }

 private:
  std::map<std::string, std::string> fields_;
};

struct Record {
  std::uint64_t at = 0;  // position of its first byte in the file
  Header header;
  std::uint64_t data_at = 0;
  std::size_t data_size = 0;
  [[nodiscard]] std::uint64_t end() const { return data_at + data_size; }
};

struct Connection {
  std::string topic;
  Header description;
  [[nodiscard]] bool operator==(const Connection& other) const {
    return topic == other.topic && description == other.description;
  }
};

struct Stamp {
  std::uint32_t sec = 0;
  std::uint32_t nsec = 0;
  [[nodiscard]] bool operator==(const Stamp& other) const { return sec == other.sec && nsec == other.nsec; }
  [[nodiscard]] bool operator<(const Stamp& other) const {
    return std::tie(sec, nsec) < std::tie(other.sec, other.nsec);
  }
};

Stamp stamp_in(std::string_view bytes) {
  const Stamp stamp{load_little_endian<std::uint32_t>(bytes),
                    load_little_endian<std::uint32_t>(bytes.substr(4))};
  if (stamp.nsec >= 1'000'000'000)
    throw InputError("a time has " + std::to_string(stamp.nsec) + " ns, must be < 10^9");
  return stamp;
}

/// A message in its chunk.
struct Message {
  std::uint32_t offset = 0;  // position of its record
  std::uint32_t connection = 0;
  Stamp stamp;
  bool indexed = false;
};

struct Chunk {
  std::uint64_t at = 0;
  std::pair<Stamp, Stamp> times;       // of its first message and its last
  std::vector<std::uint32_t> indexed;  // connections of its index records
  bool listed = false;
};

class Walk {
 public:
  Walk(const fs::path& path, std::string name, Problems& problems, const ProgressCallback& progress,
       const StopToken& stop)
      : file_(path), name_(std::move(name)), problems_(problems), progress_(progress), stop_(stop) {}

  void run() {
    read_start();
    while (at_ < index_at_) {
      if (stop_.stop_requested()) throw StoppedError("reading " + name_ + " was stopped");
      read_chunk();
      if (progress_) {
        progress_({"checking " + name_, static_cast<std::size_t>(at_ >> 20),
                   static_cast<std::size_t>(file_.size() >> 20), "MB"});
      }
    }
    if (at_ != index_at_) fail(at_, "a chunk overlaps the index");
    read_index();
    compare();
  }

 private:
  [[noreturn]] void fail(std::uint64_t at, const std::string& why) const {
    throw InputError(name_ + ": byte " + std::to_string(at) + ": " + why);
  }

  /// Calls a function and adds the position in the file to its errors.
  template <class Call>
  auto at_place(std::uint64_t at, Call&& call) const -> decltype(call()) {
    try {
      return call();
    } catch (const InputError& error) {
      fail(at, error.what());
    }
  }

  void read_start() {
    std::string start;
    file_.read(0, static_cast<std::size_t>(std::min<std::uint64_t>(file_.size(), kMagic.size())), start);
    if (start.substr(0, 9) == "#ROSBAG V" && start != kMagic && start.size() == kMagic.size()) {
      throw InputError(name_ + ": the bag's version is not 2.0: convert it with 'rosbag fix'");
    }
    if (start != kMagic) throw InputError(name_ + ": is not a ROS bag, or is cut short");
    const Record record = record_at(kMagic.size(), file_.size());
    at_place(record.at, [&] {
      if (record.header.op() != kFileHeader) throw InputError("the bag's header is missing");
      if (!record.header.text_or_none("encryptor").empty()) throw InputError("encrypted bags cannot be read");
      index_at_ = record.header.number<std::uint64_t>("index_pos");
      connections_expected_ = record.header.number<std::uint32_t>("conn_count");
      chunks_expected_ = record.header.number<std::uint32_t>("chunk_count");
    });
    if (index_at_ == 0) {
      throw InputError(name_ + ": the bag was never closed and has no index: 'rosbag reindex' creates one");
    }
    if (index_at_ > file_.size() || (index_at_ == file_.size() && connections_expected_ > 0)) {
      throw InputError(name_ + ": its index should begin at byte " + std::to_string(index_at_) +
                       ", the file has " + std::to_string(file_.size()) +
                       ": it is cut short; 'rosbag reindex' indexes the remaining part");
    }
    if (index_at_ < record.end()) fail(record.at, "the index begins within the bag's header");
    // This space is blank, so that the header can be rewritten. Nothing is read from it, but damage here
    // suggests damage elsewhere.
    std::string room;
    file_.read(record.data_at, std::min(record.data_size, kLargestHeader), room);
    if (room.find_first_not_of(' ') != std::string::npos) {
      problems_.add("bag altered in a part that is not read",
                    name_ + ": byte " + std::to_string(record.data_at));
    }
    at_ = record.end();
  }

  /// The record at this position, which must end before `end`.
  [[nodiscard]] Record record_at(std::uint64_t at, std::uint64_t end) const {
    const auto room = [&](std::uint64_t from, std::uint64_t needed, const char* what) {
      if (from > end || needed > end - from) {
        fail(at, std::string(what) + " of " + std::to_string(needed) + " bytes, but only " +
                     std::to_string(end - std::min(from, end)) +
                     " are left: the bag is cut short or damaged");
      }
    };
    std::string bytes;
    room(at, 4, "a record");
    file_.read(at, 4, bytes);
    const std::size_t header_size = load_little_endian<std::uint32_t>(bytes);
    room(at + 4, header_size, "a record's header");
    if (header_size > kLargestHeader) fail(at, "a header of " + std::to_string(header_size) + " bytes");
    file_.read(at + 4, header_size, bytes);
    Record record{at, at_place(at, [&] { return Header(bytes); }), 0, 0};
    room(at + 4 + header_size, 4, "a record's length");
    file_.read(at + 4 + header_size, 4, bytes);
    record.data_size = load_little_endian<std::uint32_t>(bytes);
    record.data_at = at + 8 + header_size;
    room(record.data_at, record.data_size, "data");
    return record;
  }

  void read_chunk() {
    const Record record = record_at(at_, index_at_);
    chunks_.emplace_back().at = at_;
    at_place(at_, [&] {
      if (record.header.op() != kChunk) throw InputError("expected a chunk");
      const std::size_t size = record.header.number<std::uint32_t>("size");
      if (size > kLargestChunk || record.data_size > kLargestChunk) {
        throw InputError("a chunk of " + std::to_string(std::max(size, record.data_size)) +
                         " bytes, more than " + std::to_string(kLargestChunk) + " are not read");
      }
      file_.read(record.data_at, record.data_size, compressed_);
      contents_ = inflate_chunk(record.header.text("compression"), compressed_, size);
      read_contents();
    });
    at_ = record.end();
    while (at_ < index_at_) {
      const Record index = record_at(at_, index_at_);
      if (at_place(at_, [&] { return index.header.op(); }) != kIndexData) break;
      at_place(at_, [&] { read_index_data(index); });
      at_ = index.end();
    }
    for (const Message& message : messages_) {
      auto& [first, last] = chunks_.back().times;
      if (&message == &messages_.front() || message.stamp < first) first = message.stamp;
      if (&message == &messages_.front() || last < message.stamp) last = message.stamp;
      if (!message.indexed) {
        fail(chunks_.back().at, "the message at byte " + std::to_string(message.offset) +
                                    " of the chunk is not in the index: 'rosbag reindex' creates a new one");
      }
    }
  }

  /// Reads connections and messages of a chunk.
  void read_contents() {
    messages_.clear();
    starts_.clear();
    const std::string_view contents = contents_;
    for (std::size_t at = 0; at < contents.size();) {
      const auto take = [&](std::size_t& from) {
        if (contents.size() - from < 4) throw InputError("a record in the chunk is cut short");
        const std::size_t size = load_little_endian<std::uint32_t>(contents.substr(from));
        from += 4;
        if (size > contents.size() - from) {
          throw InputError("a record in the chunk needs " + std::to_string(size) + " bytes, " +
                           std::to_string(contents.size() - from) + " are left");
        }
        const std::string_view bytes = contents.substr(from, size);
        from += size;
        return bytes;
      };
      const std::size_t start = at;
      const Header header(take(at));
      const std::string_view data = take(at);
      if (header.op() == kConnection) {
        add_connection(header, data, met_);
      } else if (header.op() == kMessageData) {
        Message message;
        message.offset = static_cast<std::uint32_t>(start);
        message.connection = header.number<std::uint32_t>("conn");
        if (header.text("time").size() != 8) throw InputError("header field time has a wrong size");
        message.stamp = stamp_in(header.text("time"));
        used_.emplace(message.connection, chunks_.back().at);
        starts_[message.offset] = messages_.size();
        messages_.push_back(message);
      } else {
        throw InputError("a record of kind " + std::to_string(header.op()) + " in a chunk");
      }
    }
  }

  void read_index_data(const Record& record) {
    if (record.header.number<std::uint32_t>("ver") != 1)
      throw InputError("an index record of an unsupported version");
    const auto connection = record.header.number<std::uint32_t>("conn");
    const std::size_t count = record.header.number<std::uint32_t>("count");
    if (count * kIndexEntry != record.data_size) {
      throw InputError("an index of " + std::to_string(count) + " messages has " +
                       std::to_string(record.data_size) + " bytes");
    }
    std::string bytes;
    file_.read(record.data_at, record.data_size, bytes);
    for (std::size_t i = 0; i < count; ++i) {
      const std::string_view entry = std::string_view(bytes).substr(i * kIndexEntry, kIndexEntry);
      const Stamp stamp = stamp_in(entry);
      const auto start = starts_.find(load_little_endian<std::uint32_t>(entry.substr(8)));
      // An index may not point to the connection before a message either: the library then reads the next
      // record as a message without a check for the end of the chunk.
      if (start == starts_.end()) {
        throw InputError("the index points to byte " +
                         std::to_string(load_little_endian<std::uint32_t>(entry.substr(8))) +
                         " of the chunk, where there is no message");
      }
      Message& message = messages_[start->second];
      if (message.connection != connection || !(message.stamp == stamp) || message.indexed) {
        throw InputError("the index and the message at byte " + std::to_string(message.offset) +
                         " of the chunk disagree");
      }
      message.indexed = true;
      if (stamp.sec == 0 && stamp.nsec == 0) {
        problems_.add_altered("message at time 0 left out", name_ + ": byte " + std::to_string(record.at));
      }
    }
    auto& indexed = chunks_.back().indexed;
    if (std::find(indexed.begin(), indexed.end(), connection) != indexed.end()) {
      throw InputError("a second index of connection " + std::to_string(connection) + " in the chunk");
    }
    indexed.push_back(connection);
  }

  static void add_connection(const Header& header, std::string_view data,
                             std::map<std::uint32_t, Connection>& connections) {
    Connection connection{header.text("topic"), Header(data)};
    static_cast<void>(connection.description.text("type"));
    static_cast<void>(connection.description.text("message_definition"));
    const auto id = header.number<std::uint32_t>("conn");
    if (connection.topic.empty()) throw InputError("a connection without topic");
    const auto [known, is_new] = connections.emplace(id, connection);
    if (!is_new && !(known->second == connection)) {
      throw InputError("connection " + std::to_string(id) + " has two different descriptions");
    }
  }

  void read_index() {
    for (std::uint32_t i = 0; i < connections_expected_; ++i) {
      const Record record = record_at(at_, file_.size());
      at_place(at_, [&] {
        if (record.header.op() != kConnection) throw InputError("expected a connection");
        if (record.data_size > kLargestHeader) throw InputError("a connection's description is too large");
        std::string data;
        file_.read(record.data_at, record.data_size, data);
        const std::size_t before = listed_.size();
        add_connection(record.header, data, listed_);
        if (listed_.size() == before) throw InputError("a connection is listed twice");
      });
      at_ = record.end();
    }
    for (std::uint32_t i = 0; i < chunks_expected_; ++i) {
      const Record record = record_at(at_, file_.size());
      at_place(at_, [&] { read_chunk_info(record); });
      at_ = record.end();
    }
    if (at_ != file_.size()) {
      fail(at_, std::to_string(file_.size() - at_) + " bytes after the end of the index");
    }
  }

  void read_chunk_info(const Record& record) {
    if (record.header.op() != kChunkInfo) throw InputError("expected a chunk info record");
    if (record.header.number<std::uint32_t>("ver") != 1)
      throw InputError("a chunk info record of an unsupported version");
    const auto place = record.header.number<std::uint64_t>("chunk_pos");
    const auto chunk = std::lower_bound(chunks_.begin(), chunks_.end(), place,
                                        [](const Chunk& c, std::uint64_t at) { return c.at < at; });
    if (chunk == chunks_.end() || chunk->at != place || chunk->listed) {
      throw InputError("the index lists a chunk at byte " + std::to_string(place) +
                       ", where no chunk begins or which is listed already");
    }
    chunk->listed = true;
    const auto time = [&](const char* name) {
      if (record.header.text(name).size() != 8) throw InputError("a time has a wrong size");
      return stamp_in(record.header.text(name));
    };
    if (!(time("start_time") == chunk->times.first) || !(time("end_time") == chunk->times.second)) {
      problems_.add("bag altered in a part that is not read", name_ + ": byte " + std::to_string(record.at));
    }
    const std::size_t count = record.header.number<std::uint32_t>("count");
    if (count * kCountEntry != record.data_size)
      throw InputError("the list of a chunk's connections is cut short");
    std::string bytes;
    file_.read(record.data_at, record.data_size, bytes);
    std::vector<std::uint32_t> counted;
    for (std::size_t i = 0; i < count; ++i) {
      counted.push_back(load_little_endian<std::uint32_t>(std::string_view(bytes).substr(i * kCountEntry)));
    }
    std::vector<std::uint32_t> indexed = chunk->indexed;
    std::sort(counted.begin(), counted.end());
    std::sort(indexed.begin(), indexed.end());
    if (counted != indexed)
      throw InputError("the index of the chunk at byte " + std::to_string(place) + " is incomplete");
  }

  void compare() const {
    if (chunks_.size() != chunks_expected_) {
      throw InputError(name_ + ": " + std::to_string(chunks_.size()) + " chunks, the index lists " +
                       std::to_string(chunks_expected_));
    }
    for (const auto& [id, connection] : met_) {
      const auto listed = listed_.find(id);
      if (listed == listed_.end() || !(listed->second == connection)) {
        throw InputError(name_ + ": connection " + std::to_string(id) + " (" + connection.topic +
                         ") has two different descriptions");
      }
    }
    for (const auto& [id, at] : used_) {
      if (listed_.count(id) == 0)
        fail(at, "messages of connection " + std::to_string(id) + ", which is not listed");
    }
  }

  RawFile file_;
  std::string name_;
  Problems& problems_;
  const ProgressCallback& progress_;
  StopToken stop_;
  std::uint64_t at_ = 0;
  std::uint64_t index_at_ = 0;
  std::uint32_t connections_expected_ = 0;
  std::uint32_t chunks_expected_ = 0;
  std::string compressed_, contents_;
  std::vector<Message> messages_;                // of this chunk
  std::map<std::uint32_t, std::size_t> starts_;  // where a message of this chunk begins
  std::vector<Chunk> chunks_;
  std::map<std::uint32_t, Connection> met_;      // in chunks
  std::map<std::uint32_t, Connection> listed_;   // in the index
  std::map<std::uint32_t, std::uint64_t> used_;  // by messages, and the first chunk
};

}  // namespace

void check_bag(const fs::path& file, const std::string& name, Problems& problems,
               const ProgressCallback& progress, const StopToken& stop) {
  Walk(file, name, problems, progress, stop).run();
}

}  // namespace loopwise::bags
