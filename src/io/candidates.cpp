// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/candidates.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

namespace loopwise {
namespace {

constexpr std::array<const char*, 7> kPoseColumns{"x", "y", "z", "qx", "qy", "qz", "qw"};

/// Column names in the first line that is not blank.
std::vector<std::string> header_of(std::string_view text, const std::string& source) {
  const std::size_t begin = std::min(text.find_first_not_of(" \t\r\n"), text.size());
  std::string_view line = text.substr(begin, text.find('\n', begin) - begin);
  std::vector<std::string> names;
  for (bool more = true; more;) {
    const std::size_t comma = line.find(',');
    more = comma != std::string_view::npos;
    std::string name(line.substr(0, comma));
    name.erase(
        std::remove_if(name.begin(), name.end(), [](char c) { return c == ' ' || c == '\t' || c == '\r'; }),
        name.end());
    names.push_back(name);
    if (more) line.remove_prefix(comma + 1);
  }
  const auto has = [&](const char* name) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  const auto known = [&](const std::string& name) {
    return name == "from" || name == "to" || name == "score" ||
           std::find(kPoseColumns.begin(), kPoseColumns.end(), name) != kPoseColumns.end();
  };
  const bool pose = std::any_of(kPoseColumns.begin(), kPoseColumns.end(), has);
  if (!has("from") || !has("to") || !std::all_of(names.begin(), names.end(), known) ||
      pose != std::all_of(kPoseColumns.begin(), kPoseColumns.end(), has)) {
    throw ParseError(source, 1, "expected the columns from,to and optionally score and x,y,z,qx,qy,qz,qw");
  }
  return names;
}

class CandidateReader {
 public:
  CandidateReader(std::string_view text, const std::string& source)
      : names_(header_of(text, source)), table_(CsvTable::parse(text, source, names_)) {}

  [[nodiscard]] std::vector<LoopCandidate> read() const {
    const auto score = column("score"), first = column("x");
    std::vector<LoopCandidate> candidates;
    for (std::size_t row = 0; row < table_.size(); ++row) {
      LoopCandidate candidate;
      candidate.from = table_.key(row, *column("from"));
      candidate.to = table_.key(row, *column("to"));
      candidate.source = CandidateSource::kUser;
      if (candidate.from == candidate.to)
        table_.fail(row, *column("to"), "a node cannot be paired with itself");
      auto recognition = std::make_shared<Recognition>();
      if (score && !table_.text(row, *score).empty()) recognition->similarity = table_.number(row, *score);
      if (recognition->similarity < 0.0 || recognition->similarity > 1.0)
        table_.fail(row, *score, "must be in [0, 1]");
      if (first) recognition->T_from_to = pose(row);
      recognition->covariance.diagonal() << 1.0, 1.0, 1.0, 0.01, 0.01, 0.01;
      if (recognition->T_from_to || !std::isnan(recognition->similarity))
        candidate.recognition = std::move(recognition);
      candidates.push_back(std::move(candidate));
    }
    return candidates;
  }

 private:
  [[nodiscard]] std::optional<std::size_t> column(const char* name) const {
    const auto found = std::find(names_.begin(), names_.end(), name);
    if (found == names_.end()) return std::nullopt;
    return static_cast<std::size_t>(found - names_.begin());
  }

  [[nodiscard]] std::optional<Eigen::Isometry3d> pose(std::size_t row) const {
    std::array<double, kPoseColumns.size()> v{};
    std::size_t given = 0;
    for (std::size_t i = 0; i < v.size(); ++i) {
      v[i] = table_.number_or_nan(row, *column(kPoseColumns[i]));
      given += std::isnan(v[i]) ? 0 : 1;
    }
    if (given == 0) return std::nullopt;
    if (given < v.size())
      table_.fail(row, *column("x"), "a pose needs all of x,y,z,qx,qy,qz,qw, or no value");
    const Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
    if (std::abs(q.norm() - 1.0) > 1e-2)
      table_.fail(row, *column("qw"), "the quaternion is not of unit length");
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = q.normalized().toRotationMatrix();
    T.translation() << v[0], v[1], v[2];
    return T;
  }

  std::vector<std::string> names_;
  CsvTable table_;
};

}  // namespace

std::vector<LoopCandidate> parse_candidates(std::string_view text, const std::string& source) {
  return CandidateReader(text, source).read();
}

std::vector<LoopCandidate> read_candidates(const std::filesystem::path& path) {
  return parse_candidates(read_file(path), path.string());
}

}  // namespace loopwise
