// SPDX-License-Identifier: BSD-3-Clause
#include "rosbag2.hpp"

#include <loopwise/core/error.hpp>

#include "cdr.hpp"
#include "decompress.hpp"
#include "mission_parts.hpp"
#include "temporary_file.hpp"

namespace loopwise::bags {
namespace {

constexpr std::string_view kMcapMark("\x89MCAP0\r\n", 8), kSqliteMark("SQLite format 3\0", 16),
    kZstdMark("\x28\xb5\x2f\xfd", 4);

std::unique_ptr<Storage> open_plain(const NumberedFile& file, const Opening& opening) {
  if (parts::begins_with(file.file.path, kMcapMark)) return open_mcap(file, opening);
  if (parts::begins_with(file.file.path, kSqliteMark)) return open_db3(file, opening);
  throw InputError(file.file.name +
                   ": is not a ROS 2 bag: expected MCAP or SQLite (.db3), or one of them packed by zstd");
}

/// A bag that is decompressed to a temporary file.
class Unpacked : public Storage {
 public:
  Unpacked(const NumberedFile& file, const Opening& opening) {
    inflate_zstd_file(file.file.path, file.file.name, copy_.path(), opening.stop);
    storage_ = open_plain({file.number, {copy_.path(), file.file.name}}, opening);
    connections_ = storage_->connections();
  }
  std::vector<Entry> index(const std::vector<bool>& wanted) override { return storage_->index(wanted); }
  std::string read(const Entry& entry) override { return storage_->read(entry); }

 private:
  TemporaryFile copy_;  // destroyed last
  std::unique_ptr<Storage> storage_;
};

}  // namespace

bool rosbag2_available() {
  return true;
}

std::unique_ptr<Storage> open_rosbag2(const NumberedFile& file, const Opening& opening) {
  if (parts::begins_with(file.file.path, kZstdMark)) return std::make_unique<Unpacked>(file, opening);
  return open_plain(file, opening);
}

Connection rosbag2_connection(std::size_t bag, const std::string& topic, const std::string& type,
                              const std::string& encoding, const std::string& schema_encoding,
                              const std::string& definition) {
  Connection out;
  out.bag = bag;
  out.topic = topic;
  out.type = cdr::ros1_type(type);
  out.encoding_name = encoding;
  if (encoding == "ros1") {
    out.encoding = Encoding::kRos1;
    out.definition = definition;
    return out;
  }
  out.encoding = encoding == "cdr" ? Encoding::kCdr : Encoding::kOther;
  if (schema_encoding == "ros2msg") out.definition = cdr::ros1_definition(definition);
  if (out.definition.empty()) out.definition = cdr::known_definition(out.type);
  return out;
}

std::string unpacked_message(std::string bytes) {
  return is_zstd(bytes) ? inflate_zstd(bytes, kLargestPiece) : bytes;
}

}  // namespace loopwise::bags
