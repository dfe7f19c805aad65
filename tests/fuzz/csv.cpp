// SPDX-License-Identifier: BSD-3-Clause
// The first byte chooses the number of columns, 1 to 4.
#include <loopwise/io/csv.hpp>

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(csv, bytes) {
  using namespace loopwise;
  const std::vector<std::string> all = {"a", "b", "c", "d"};
  const std::vector<std::string> columns(
      all.begin(), all.begin() + 1 + static_cast<std::ptrdiff_t>(fuzz::take_choice(bytes, 4)));
  const auto table = fuzz::attempt([&] { return CsvTable::parse(bytes, "fuzz.csv", columns); });
  if (!table) return;
  CsvText csv(columns);
  for (std::size_t row = 0; row < table->size(); ++row) {
    fuzz::expect(table->line(row) > 1, "rows stand after the header");
    const auto text = [&](std::size_t column) { return table->text(row, column); };
    if (columns.size() == 1) csv.row(text(0));
    if (columns.size() == 2) csv.row(text(0), text(1));
    if (columns.size() == 3) csv.row(text(0), text(1), text(2));
    if (columns.size() == 4) csv.row(text(0), text(1), text(2), text(3));
    for (std::size_t column = 0; column < columns.size(); ++column) {
      if (!fuzz::one_in(4 * columns.size(), table->text(row, column))) continue;  // most are no numbers
      static_cast<void>(fuzz::attempt([&] { return table->key(row, column); }));
      static_cast<void>(fuzz::attempt([&] { return table->integer(row, column); }));
      const auto number = fuzz::attempt([&] { return table->number(row, column); });
      fuzz::expect(!number || std::isfinite(*number), "numbers are finite");
      static_cast<void>(fuzz::attempt([&] { return table->number_or_nan(row, column); }));
    }
  }
  const CsvTable again = CsvTable::parse(csv.text(), "again.csv", columns);
  fuzz::expect(again.size() == table->size(), "written and read again: as many rows");
  for (std::size_t row = 0; row < again.size(); ++row) {
    for (std::size_t column = 0; column < columns.size(); ++column) {
      fuzz::expect(again.text(row, column) == table->text(row, column),
                   "written and read again: the same values");
    }
  }
}
