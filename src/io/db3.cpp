// SPDX-License-Identifier: BSD-3-Clause
#include <map>

#include <loopwise/core/error.hpp>

#include "mission_parts.hpp"
#include "rosbag2.hpp"
#include "sqlite_file.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

using sqlite::Statement;

class Db3 : public Storage {
 public:
  Db3(const NumberedFile& file, const Opening& opening)
      : name_(file.file.name), database_(file.file.path, name_, opening.stop), opening_(&opening) {
    database_.checked([&] {
      check_tables();
      read_topics(file.number);
      read_index();
      message_ =
          std::make_unique<Statement>(database_.handle(), "SELECT data FROM messages WHERE rowid = ?1");
    });
    opening_ = nullptr;
  }

  std::vector<Entry> index(const std::vector<bool>& wanted) override { return sorted(entries_, wanted); }

  std::string read(const Entry& entry) override {
    try {
      message_->bind(static_cast<std::int64_t>(entry.place));
      if (!message_->next()) throw InputError("is missing");
      if (!message_->is_blob(0)) throw InputError("has no data");
      std::string bytes = message_->bytes(0);
      message_->reset();
      return unpacked_message(std::move(bytes));
    } catch (const InputError& error) {
      throw InputError(name_ + ": row " + std::to_string(static_cast<std::int64_t>(entry.place)) +
                       " of messages, topic " + connections_[entry.connection].topic + ": " + error.what());
    }
  }

 private:
  void check_tables() {
    if (opening_->progress) opening_->progress({"checking " + name_, 0, 0, ""});
    database_.check_pages();
    if (!database_.has_table("messages") || !database_.has_table("topics"))
      throw InputError("an SQLite database without the tables messages and topics: not a ROS 2 bag");
  }

  void read_topics(std::size_t bag) {
    std::map<std::string, std::pair<std::string, std::string>> definitions;  // type -> encoding, text
    if (database_.has_table("message_definitions")) {
      Statement rows(database_.handle(),
                     "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions");
      while (rows.next()) definitions[rows.bytes(0)] = {rows.bytes(1), rows.bytes(2)};
    }
    Statement rows(database_.handle(), "SELECT id, name, type, serialization_format FROM topics ORDER BY id");
    while (rows.next()) {
      const std::string type = rows.bytes(2);
      const auto& [encoding, definition] = definitions[type];
      if (!topics_.emplace(rows.integer(0, "the id of a topic"), connections_.size()).second)
        throw InputError("two topics have the same id");
      connections_.push_back(
          rosbag2_connection(bag, rows.bytes(1), type, rows.bytes(3), encoding, definition));
    }
  }

  void read_index() {
    Statement rows(database_.handle(), "SELECT rowid, topic_id, timestamp FROM messages");
    while (rows.next()) {
      const std::int64_t row = rows.integer(0, "the id of a message");
      const std::string where = "row " + std::to_string(row) + " of messages";
      const auto topic = topics_.find(rows.integer(1, (where + ": topic_id").c_str()));
      if (topic == topics_.end()) {
        opening_->problems.add_altered("message of an unknown topic left out", name_ + ": " + where);
        continue;
      }
      Connection& connection = connections_[topic->second];
      ++connection.messages;
      if (!opening_->known(connection.type)) continue;
      if (entries_.size() == kMostMessages)
        throw InputError("more than " + std::to_string(kMostMessages) + " messages: split the recording");
      Entry entry;
      entry.stamp_ns = rows.integer(2, (where + ": timestamp").c_str());
      entry.place = static_cast<std::uint64_t>(row);
      entry.connection = static_cast<std::uint32_t>(topic->second);
      entries_.push_back(entry);
    }
  }

  std::string name_;
  sqlite::Database database_;
  std::unique_ptr<Statement> message_;          // destroyed before its database
  const Opening* opening_;                      // only while the file is opened
  std::map<std::int64_t, std::size_t> topics_;  // number in connections_
  std::vector<Entry> entries_;
};

}  // namespace

std::unique_ptr<Storage> open_db3(const NumberedFile& file, const Opening& opening) {
  return std::make_unique<Db3>(file, opening);
}

}  // namespace loopwise::bags
