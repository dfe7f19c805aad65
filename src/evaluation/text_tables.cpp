// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/evaluation/text_tables.hpp>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace loopwise {

std::string fixed(double value, int decimals) {
  if (std::isnan(value)) return "-";
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  return text;
}

std::string counted(std::size_t count, const std::string& noun, const std::string& several) {
  return std::to_string(count) + " " + (count == 1 ? noun : several.empty() ? noun + "s" : several);
}

std::string table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
  for (const auto& row : rows) {
    widths.resize(std::max(widths.size(), row.size()), 0);
    for (std::size_t c = 0; c < row.size(); ++c) widths[c] = std::max(widths[c], row[c].size());
  }
  std::string out;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    std::string line;
    for (std::size_t c = 0; c < rows[r].size(); ++c) {
      const std::string gap(widths[c] - rows[r][c].size(), ' ');
      line += c == 0 ? rows[r][c] + gap : "  " + gap + rows[r][c];
    }
    out += line + "\n";
    if (r == 0) out += std::string(line.size(), '-') + "\n";
  }
  return out;
}

std::string markdown_table(const std::vector<std::vector<std::string>>& rows) {
  std::string out;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    for (const std::string& text : rows[r]) {
      out += "| ";
      for (const char c : text) out += c == '|' ? std::string("\\|") : std::string(1, c == '\n' ? ' ' : c);
      out += " ";
    }
    out += "|\n";
    if (r > 0) continue;
    for (std::size_t c = 0; c < rows[r].size(); ++c) out += "| --- ";
    out += "|\n";
  }
  return out;
}

}  // namespace loopwise
