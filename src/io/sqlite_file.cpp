// SPDX-License-Identifier: BSD-3-Clause
#include "sqlite_file.hpp"

#include <cctype>
#include <new>

#include "bag_storage.hpp"
#include "mission_parts.hpp"
#include "raw_file.hpp"

namespace loopwise::sqlite {
namespace {

namespace fs = std::filesystem;

/// Steps of SQLite's virtual machine between two checks for a stop request.
constexpr int kStepsBetweenLooks = 100'000;

/// A path as a URI of SQLite that opens the file without locks and without writing to its folder.
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

}  // namespace

Statement::Statement(sqlite3* database, const std::string& sql) : database_(database) {
  check(sqlite3_prepare_v2(database, sql.c_str(), -1, &statement_, nullptr));
}

void Statement::bind(std::int64_t value) {
  sqlite3_reset(statement_);
  check(sqlite3_bind_int64(statement_, 1, value));
}

bool Statement::next() {
  const int result = sqlite3_step(statement_);
  if (result != SQLITE_ROW && result != SQLITE_DONE) check(result);
  return result == SQLITE_ROW;
}

std::int64_t Statement::integer(int column, const char* what) const {
  if (sqlite3_column_type(statement_, column) != SQLITE_INTEGER)
    throw InputError(std::string(what) + " is not a whole number");
  return sqlite3_column_int64(statement_, column);
}

std::string Statement::bytes(int column) const {
  const void* const data = sqlite3_column_blob(statement_, column);
  const int size = sqlite3_column_bytes(statement_, column);
  return data == nullptr ? std::string()
                         : std::string(static_cast<const char*>(data), static_cast<std::size_t>(size));
}

void Statement::check(int result) const {
  if (result == SQLITE_OK) return;
  if (result == SQLITE_NOMEM) throw std::bad_alloc();
  throw InputError(std::string("SQLite: ") + sqlite3_errmsg(database_));
}

Database::Database(const fs::path& path, const std::string& name, const StopToken& stop)
    : name_(name), stop_(stop) {
  // A journal beside the file has rows that the file lacks, and reading it needs locks.
  const bool has_journal = parts::exists(path.string() + "-wal") || parts::exists(path.string() + "-journal");
  if (!has_journal) check_size(path);
  sqlite3* made = nullptr;
  const int result =
      has_journal ? sqlite3_open_v2(path.c_str(), &made, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr)
                  : sqlite3_open_v2(immutable_uri(path).c_str(), &made,
                                    SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_URI, nullptr);
  database_.reset(made);
  if (made == nullptr) throw std::bad_alloc();
  if (result != SQLITE_OK) throw InputError(name_ + ": SQLite: " + sqlite3_errmsg(made));
  sqlite3_limit(made, SQLITE_LIMIT_LENGTH, static_cast<int>(bags::kLargestPiece));
  sqlite3_db_config(made, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(made, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
}

/// SQLite accepts a file whose last page is cut off, so the size is checked here.
void Database::check_size(const fs::path& path) const {
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
  const bool counts_pages =
      number(24, 4) == number(92, 4);  // otherwise the last writer was a version before 3.7
  if (counts_pages && pages * page > file.size()) {
    throw InputError(name_ + ": the database is cut short: it should have " + std::to_string(pages * page) +
                     " bytes, the file has " + std::to_string(file.size()) +
                     "; 'sqlite3 FILE .recover' saves the readable part");
  }
}

void Database::watch(bool on) {
  const auto look = [](void* self) { return static_cast<Database*>(self)->stop_.stop_requested() ? 1 : 0; };
  sqlite3_progress_handler(database_.get(), on ? kStepsBetweenLooks : 0, on ? +look : nullptr, this);
}

void Database::check_pages() {
  Statement check(database_.get(), "PRAGMA quick_check(1)");
  while (check.next()) {
    const std::string found = check.bytes(0);
    if (found == "ok") continue;
    throw InputError("the database is damaged: " + found +
                     "; 'sqlite3 FILE .recover' saves the readable part");
  }
}

bool Database::has_table(const std::string& table) {
  if (tables_.empty()) {
    Statement rows(database_.get(), "SELECT name FROM sqlite_master WHERE type = 'table' AND rootpage > 0");
    while (rows.next()) tables_.insert(rows.bytes(0));
  }
  return tables_.count(table) != 0;
}

}  // namespace loopwise::sqlite
