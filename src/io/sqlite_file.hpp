// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// SQLite databases of other programs, opened only for reading. Private to io.
#pragma once

#include <sqlite3.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <set>
#include <string>

#include <loopwise/core/error.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise::sqlite {

/// A prepared statement.
class Statement {
 public:
  /// \throws InputError with SQLite's message
  Statement(sqlite3* database, const std::string& sql);
  ~Statement() { sqlite3_finalize(statement_); }
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  /// Sets the only parameter and restarts the statement.
  void bind(std::int64_t value);
  void reset() { sqlite3_reset(statement_); }
  /// Advances to the next row. False at the end.
  bool next();
  /// \throws InputError naming `what` if it is not a whole number
  [[nodiscard]] std::int64_t integer(int column, const char* what) const;
  /// As SQLite converts it; 0 if it is not a number.
  [[nodiscard]] double number(int column) const { return sqlite3_column_double(statement_, column); }
  /// Text or bytes.
  [[nodiscard]] std::string bytes(int column) const;
  [[nodiscard]] bool is_blob(int column) const {
    return sqlite3_column_type(statement_, column) == SQLITE_BLOB;
  }

 private:
  void check(int result) const;

  sqlite3* database_;
  sqlite3_stmt* statement_ = nullptr;
};

/// A database that is opened without locks and without writing to its folder, unless it has a journal.
class Database {
 public:
  /// \param name of the file, for errors. \throws InputError if the file is cut short or no database; IoError
  Database(const std::filesystem::path& path, const std::string& name, const StopToken& stop);

  /// Calls `work()` and adds the name of the file to its errors. \throws StoppedError
  template <class Work>
  void checked(Work&& work) {
    watch(true);
    try {
      work();
    } catch (const InputError& error) {
      watch(false);
      if (stop_.stop_requested()) throw StoppedError("reading " + name_ + " was stopped");
      throw InputError(name_ + ": " + error.what());
    }
    watch(false);
  }
  /// SQLite's own quick check. \throws InputError without the name of the file
  void check_pages();
  /// Whether a real table has this name. Views and virtual tables are excluded, because they run code of the
  /// file.
  [[nodiscard]] bool has_table(const std::string& table);
  [[nodiscard]] sqlite3* handle() const { return database_.get(); }

 private:
  struct Close {
    void operator()(sqlite3* database) const { sqlite3_close(database); }
  };
  void check_size(const std::filesystem::path& path) const;
  void watch(bool on);

  std::string name_;
  StopToken stop_;
  std::unique_ptr<sqlite3, Close> database_;
  std::set<std::string> tables_;
};

}  // namespace loopwise::sqlite
