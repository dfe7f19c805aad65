// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/csv.hpp>

#include <cmath>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "file_kind.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

/// Trims only the front: blanks at the end may belong to a quoted value that continues in the next line.
std::string_view without_blanks_before(std::string_view line) {
  while (!line.empty() && text::is_blank(line.front())) line.remove_prefix(1);
  return line;
}

/// Splits one record. A quoted value may continue over several lines, which are taken from `lines`.
std::vector<std::string> split_record(std::string_view line, text::Lines& lines, const std::string& file) {
  const std::size_t first_line = lines.number();
  std::vector<std::string> values;
  while (true) {
    std::string_view rest = without_blanks_before(line);
    if (!rest.empty() && rest.front() == '"') {
      std::string value;
      rest.remove_prefix(1);
      while (true) {
        const std::size_t quote = rest.find('"');
        value += rest.substr(0, quote);
        if (quote == std::string_view::npos) {
          value += '\n';
          if (!lines.next(rest)) throw ParseError(file, first_line, "a quoted value is not closed");
          continue;
        }
        rest.remove_prefix(quote + 1);
        if (rest.empty() || rest.front() != '"') break;
        value += '"';
        rest.remove_prefix(1);
      }
      rest = without_blanks_before(rest);
      values.push_back(std::move(value));
      if (rest.empty()) return values;
      if (rest.front() != ',') throw ParseError(file, lines.number(), "text after a quoted value");
      line = rest.substr(1);
    } else {
      const std::size_t comma = line.find(',');
      values.emplace_back(text::trim(line.substr(0, comma)));
      if (comma == std::string_view::npos) return values;
      line.remove_prefix(comma + 1);
    }
  }
}

std::string joined(const std::vector<std::string>& values) {
  std::string out;
  for (const std::string& value : values) out += (out.empty() ? "" : ",") + value;
  return out;
}

}  // namespace

CsvTable::CsvTable(const std::filesystem::path& path, std::vector<std::string> columns)
    : CsvTable(path.string(), read_file(path), std::move(columns)) {}

CsvTable CsvTable::parse(std::string_view text, const std::string& source, std::vector<std::string> columns) {
  return CsvTable(source, text, std::move(columns));
}

CsvTable::CsvTable(std::string source, std::string_view text, std::vector<std::string> columns)
    : file_(std::move(source)), columns_(std::move(columns)) {
  refuse_foreign(text, file_,
                 {FileKind::kEmpty, FileKind::kTum, FileKind::kKitti, FileKind::kG2o, FileKind::kJson,
                  FileKind::kMarkup},
                 "a table with the header \"" + joined(columns_) + "\"");
  text::Lines lines(text);
  bool has_header = false;
  for (std::string_view line; lines.next(line);) {
    if (text::trim(line).empty()) continue;
    const std::size_t number = lines.number();
    std::vector<std::string> values = split_record(line, lines, file_);
    if (!has_header) {
      if (values != columns_) {
        throw ParseError(
            file_, number,
            "header is " + text::quoted(joined(values)) + ", expected \"" + joined(columns_) + "\"");
      }
      has_header = true;
      continue;
    }
    if (values.size() != columns_.size()) {
      throw ParseError(
          file_, number,
          std::to_string(values.size()) + " values, expected " + std::to_string(columns_.size()));
    }
    for (std::string& value : values) values_.push_back(std::move(value));
    lines_.push_back(number);
  }
  if (!has_header) throw ParseError(file_, 1, "is empty, expected the header \"" + joined(columns_) + "\"");
}

void CsvTable::fail(std::size_t row, std::size_t column, const std::string& why) const {
  throw ParseError(file_, lines_[row], "column \"" + columns_[column] + "\": " + why);
}

Key CsvTable::key(std::size_t row, std::size_t column) const {
  try {
    return parse_key(text(row, column));
  } catch (const InputError&) {
    fail(
        row, column,
        text::quoted(text(row, column)) + " is not a key: expected a 64-bit number or a letter and an index");
  }
}

std::int64_t CsvTable::integer(std::size_t row, std::size_t column) const {
  std::int64_t value = 0;
  if (!text::parse_int64(text(row, column), value)) {
    fail(row, column, text::quoted(text(row, column)) + " is not a 64-bit whole number");
  }
  return value;
}

double CsvTable::number(std::size_t row, std::size_t column) const {
  double value = 0.0;
  switch (text::parse_double(text(row, column), value)) {
    case text::Number::kNotANumber:
      fail(row, column, text::quoted(text(row, column)) + " is not a number");
    case text::Number::kNotFinite:
      fail(row, column, text::quoted(text(row, column)) + " is not finite");
    case text::Number::kOk:
      break;
  }
  return value;
}

double CsvTable::number_or_nan(std::size_t row, std::size_t column) const {
  const std::string& value = text(row, column);
  if (value.empty() || value == "nan" || value == "NaN") return std::nan("");
  return number(row, column);
}

CsvText::CsvText(const std::vector<std::string>& columns) : columns_(columns.size()) {
  for (const std::string& column : columns) add_text(column);
  text_.back() = '\n';
}

CsvText& CsvText::row(const std::vector<std::string>& values) {
  begin_row(values.size());
  for (const std::string& value : values) add_text(value);
  text_.back() = '\n';
  return *this;
}

void CsvText::begin_row(std::size_t count) const {
  if (count != columns_) {
    throw InputError("csv row of " + std::to_string(count) + " values for " + std::to_string(columns_) +
                     " columns");
  }
}

void CsvText::add_text(std::string_view value) {
  // An empty value alone would give a blank line, which readers skip.
  const bool alone = value.empty() && columns_ == 1;
  const bool plain =
      !alone && value.find_first_of(",\"\n\r") == std::string_view::npos && text::trim(value) == value;
  if (plain) {
    text_ += value;
  } else {
    text_ += '"';
    for (const char c : value) text_.append(c == '"' ? 2 : 1, c);
    text_ += '"';
  }
  text_ += ',';
}

void CsvText::add_number(double value) {
  if (!std::isnan(value)) text::append(text_, value);
  text_ += ',';
}

}  // namespace loopwise
