// SPDX-License-Identifier: BSD-3-Clause
#include <sqlite3.h>

#include <map>
#include <set>

#include <loopwise/core/error.hpp>

#include "mission_parts.hpp"
#include "raw_file.hpp"
#include "rosbag2.hpp"
#include "text.hpp"

namespace loopwise::bags {
namespace {

namespace fs = std::filesystem;

/// Steps of SQLite's virtual machine between looks at whether to stop.
constexpr int kStepsBetweenLooks = 100'000;

/// A path as SQLite's URI, by which a file can be opened without locks and without its folder being written
/// to.
std::string immutable_uri(const fs::path& path) {
  constexpr char kDigits[] = "0123456789ABCDEF";
  std::string out = "file:";
  for (const char c : fs::absolute(path).string()) {
    const auto byte = static_cast<unsigned char>(c);
    if (std::isalnum(byte) != 0 || c == '/' || c == '-' || c == '_' || c == '.') {
      out += c;
    } else {
      ((out += '%') += kDigits[byte >> 4]) += kDigits[byte & 15];
    }
  }
  return out + "?immutable=1";
}

/// A statement that is prepared once.
class Statement {
 public:
  Statement(sqlite3* database, const std::string& sql) : database_(database) {
    check(sqlite3_prepare_v2(database, sql.c_str(), -1, &statement_, nullptr));
  }
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  void bind(std::int64_t value) {
    sqlite3_reset(statement_);
    check(sqlite3_bind_int64(statement_, 1, value));
  }
  void reset() { sqlite3_reset(statement_); }
  /// False at the end.
  bool next() {
    const int result = sqlite3_step(statement_);
    if (result != SQLITE_ROW && result != SQLITE_DONE) check(result);
    return result == SQLITE_ROW;
  }
  [[nodiscard]] std::int64_t integer(int column, const char* what) const {
    if (sqlite3_column_type(statement_, column) != SQLITE_INTEGER)
      throw InputError(std::string(what) + " is no whole number");
    return sqlite3_column_int64(statement_, column);
  }
  /// Text or bytes.
  [[nodiscard]] std::string bytes(int column) const {
    const void* const data = sqlite3_column_blob(statement_, column);
    const int size = sqlite3_column_bytes(statement_, column);
    return data == nullptr ? std::string()
                           : std::string(static_cast<const char*>(data), static_cast<std::size_t>(size));
  }
  [[nodiscard]] bool is_blob(int column) const {
    return sqlite3_column_type(statement_, column) == SQLITE_BLOB;
  }

 private:
  void check(int result) const {
    if (result == SQLITE_OK) return;
    if (result == SQLITE_NOMEM) throw std::bad_alloc();
    throw InputError(std::string("SQLite: ") + sqlite3_errmsg(database_));
  }

  sqlite3* database_;
  sqlite3_stmt* statement_ = nullptr;
};

class Db3 : public Storage {
 public:
  Db3(const NumberedFile& file, const Opening& opening) : name_(file.file.name), opening_(&opening) {
    open(file.file.path);
    call([&] {
      check_pages();
      read_topics(file.number);
      read_index();
      message_ = std::make_unique<Statement>(database_.get(), "SELECT data FROM messages WHERE rowid = ?1");
    });
    sqlite3_progress_handler(database_.get(), 0, nullptr, nullptr);
    opening_ = nullptr;
  }

  std::vector<Entry> index(const std::vector<bool>& wanted) override { return sorted(entries_, wanted); }

  std::string read(const Entry& entry) override {
    try {
      message_->bind(static_cast<std::int64_t>(entry.place));
      if (!message_->next()) throw InputError("is missing");
      if (!message_->is_blob(0)) throw InputError("holds no bytes");
      std::string bytes = message_->bytes(0);
      message_->reset();
      return unpacked_message(std::move(bytes));
    } catch (const InputError& error) {
      throw InputError(name_ + ": row " + std::to_string(static_cast<std::int64_t>(entry.place)) +
                       " of messages, topic " + connections_[entry.connection].topic + ": " + error.what());
    }
  }

 private:
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
  };

  /// SQLite reads a file whose last page is cut off.
  void check_size(const fs::path& path) const {
    const RawFile file(path);
    constexpr std::size_t kHeader = 100;
    if (file.size() < kHeader) throw InputError(name_ + ": the database is cut short");
    std::string header;
    file.read(0, kHeader, header);
    const auto number = [&](std::size_t at, std::size_t size) {
      std::uint64_t value = 0;
      for (std::size_t i = at; i < at + size; ++i) value = value << 8 | static_cast<unsigned char>(header[i]);
      return value;
    };
    const std::uint64_t page = number(16, 2) == 1 ? 65536 : number(16, 2), pages = number(28, 4);
    const bool counts_pages = number(24, 4) == number(92, 4);  // else a version before 3.7 wrote last
    if (counts_pages && pages * page > file.size()) {
      throw InputError(name_ + ": the database is cut short: it should have " + std::to_string(pages * page) +
                       " bytes, the file has " + std::to_string(file.size()) +
                       "; 'sqlite3 FILE .recover' writes what can be read of it");
    }
  }

  void open(const fs::path& path) {
    // A journal beside the file holds messages that the file lacks, and needs locks to be read.
    const bool has_journal =
        parts::exists(path.string() + "-wal") || parts::exists(path.string() + "-journal");
    if (!has_journal) check_size(path);
    sqlite3* made = nullptr;
    const int result =
        has_journal
            ? sqlite3_open_v2(path.c_str(), &made, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr)
            : sqlite3_open_v2(immutable_uri(path).c_str(), &made,
                              SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_URI, nullptr);
    database_.reset(made);
    if (made == nullptr) throw std::bad_alloc();
    if (result != SQLITE_OK) throw InputError(name_ + ": SQLite: " + sqlite3_errmsg(made));
    sqlite3_limit(made, SQLITE_LIMIT_LENGTH, static_cast<int>(kLargestPiece));
    sqlite3_db_config(made, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(made, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_progress_handler(
        made, kStepsBetweenLooks,
        [](void* self) { return static_cast<Db3*>(self)->opening_->stop.stop_requested() ? 1 : 0; }, this);
  }

  template <class Call>
  void call(Call&& work) {
    try {
      work();
    } catch (const InputError& error) {
      if (opening_->stop.stop_requested()) throw StoppedError("reading " + name_ + " was stopped");
      throw InputError(name_ + ": " + error.what());
    }
  }

  void check_pages() {
    if (opening_->progress) opening_->progress({"checking " + name_, 0, 0, ""});
    Statement check(database_.get(), "PRAGMA quick_check(1)");
    while (check.next()) {
      const std::string found = check.bytes(0);
      if (found == "ok") continue;
      throw InputError("the database is damaged: " + found +
                       "; 'sqlite3 FILE .recover' writes what can be read of it");
    }
    // Views and virtual tables would run what the file says.
    Statement tables(database_.get(), "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0");
    while (tables.next()) tables_.insert(tables.bytes(0));
    if (tables_.count("messages") == 0 || tables_.count("topics") == 0)
      throw InputError("an SQLite database without the tables messages and topics: no bag of ROS 2");
  }

  void read_topics(std::size_t bag) {
    std::map<std::string, std::pair<std::string, std::string>> definitions;  // type -> encoding, text
    if (tables_.count("message_definitions") != 0) {
      Statement rows(database_.get(),
                     "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions");
      while (rows.next()) definitions[rows.bytes(0)] = {rows.bytes(1), rows.bytes(2)};
    }
    Statement rows(database_.get(), "SELECT id, name, type, serialization_format FROM topics ORDER BY id");
    while (rows.next()) {
      const std::string type = rows.bytes(2);
      const auto& [encoding, definition] = definitions[type];
      if (!topics_.emplace(rows.integer(0, "the id of a topic"), connections_.size()).second)
        throw InputError("two topics of one id");
      connections_.push_back(
          rosbag2_connection(bag, rows.bytes(1), type, rows.bytes(3), encoding, definition));
    }
  }

  void read_index() {
    Statement rows(database_.get(), "SELECT rowid, topic_id, timestamp FROM messages");
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
  std::unique_ptr<sqlite3, Close> database_;
  std::unique_ptr<Statement> message_;  // goes before its database
  const Opening* opening_;              // while it is opened
  std::set<std::string> tables_;
  std::map<std::int64_t, std::size_t> topics_;  // number in connections_
  std::vector<Entry> entries_;
};

}  // namespace

std::unique_ptr<Storage> open_db3(const NumberedFile& file, const Opening& opening) {
  return std::make_unique<Db3>(file, opening);
}

}  // namespace loopwise::bags
