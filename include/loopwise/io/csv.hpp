// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Small strict CSV: one header line, commas, text in double quotes if it contains special characters.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>

namespace loopwise {

/// A CSV file with a known header. Values are converted on access; errors name file, line and column.
class LOOPWISE_EXPORT CsvTable {
 public:
  /// Blank lines are skipped, blanks around values ignored.
  /// \throws IoError; ParseError if the header differs from `columns` or a row has another number of values.
  CsvTable(const std::filesystem::path& path, std::vector<std::string> columns);

  /// The same for a text in memory; `source` replaces the file's name in errors.
  [[nodiscard]] static CsvTable parse(std::string_view text, const std::string& source,
                                      std::vector<std::string> columns);

  /// Number of rows.
  [[nodiscard]] std::size_t size() const { return lines_.size(); }
  /// Line of a row in the file, from 1.
  [[nodiscard]] std::size_t line(std::size_t row) const { return lines_[row]; }
  /// A value of the file, without surrounding quotes and blanks.
  [[nodiscard]] const std::string& text(std::size_t row, std::size_t column) const {
    return values_[row * columns_.size() + column];
  }
  /// A decimal 64-bit key or a letter and an index. \throws ParseError
  [[nodiscard]] Key key(std::size_t row, std::size_t column) const;
  /// \throws ParseError
  [[nodiscard]] std::int64_t integer(std::size_t row, std::size_t column) const;
  /// A finite number. \throws ParseError
  [[nodiscard]] double number(std::size_t row, std::size_t column) const;
  /// A finite number, or NaN if the value is empty or "nan". \throws ParseError
  [[nodiscard]] double number_or_nan(std::size_t row, std::size_t column) const;

  /// \throws ParseError "file:line: column \"name\": why"
  [[noreturn]] void fail(std::size_t row, std::size_t column, const std::string& why) const;

 private:
  CsvTable(std::string source, std::string_view text, std::vector<std::string> columns);

  std::string file_;
  std::vector<std::string> columns_;
  std::vector<std::string> values_;  // row by row
  std::vector<std::size_t> lines_;
};

/// Builds the text of a CSV file; write it with write_file(csv.text()). Numbers are written so that they read
/// back to the same bits; NaN is written as an empty value.
class LOOPWISE_EXPORT CsvText {
 public:
  /// Begins with the header line.
  explicit CsvText(const std::vector<std::string>& columns);

  /// One value per column: text, integers (keys among them) or floating point. \throws InputError on another
  /// count.
  template <class... Values>
  CsvText& row(const Values&... values) {
    begin_row(sizeof...(values));
    (add(values), ...);
    text_.back() = '\n';
    return *this;
  }

  /// The same with the values in a vector.
  CsvText& row(const std::vector<std::string>& values);

  /// The whole file so far.
  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  void begin_row(std::size_t count) const;
  void add_text(std::string_view value);
  void add_number(double value);
  template <class T>
  void add(const T& value) {
    if constexpr (std::is_floating_point_v<T>) {
      add_number(static_cast<double>(value));
    } else if constexpr (std::is_integral_v<T>) {
      add_text(std::to_string(value));
    } else {
      add_text(value);
    }
  }

  std::size_t columns_;
  std::string text_;
};

}  // namespace loopwise
