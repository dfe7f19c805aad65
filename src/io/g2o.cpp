// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/g2o.hpp>

#include <algorithm>
#include <array>
#include <cstring>
#include <map>
#include <set>
#include <unordered_map>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "file_kind.hpp"
#include "g2o_text.hpp"
#include "information.hpp"
#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

constexpr const char* kWanted = "a g2o graph";
constexpr double kFixedSigma = 1e-4;
constexpr std::size_t kPoseNumbers = 7;
constexpr std::size_t kFactorNumbers = 28;  // a pose and the upper triangle of a 6x6 matrix

using PoseNumbers = std::array<double, kPoseNumbers>;
using FactorNumbers = std::array<double, kFactorNumbers>;

struct VertexLine {
  std::size_t line;
  PoseNumbers numbers;
};
struct EdgeLine {
  std::size_t line;
  Key from;
  Key to;
  FactorNumbers numbers;
  bool has_information;
};
struct PriorLine {
  std::size_t line;
  Key key;
  Key parameter;
  FactorNumbers numbers;
};
struct FixLine {
  std::size_t line;
  Key key;
};
struct OffsetLine {
  std::size_t line;
  Eigen::Isometry3d offset;
};

class Reader {
 public:
  explicit Reader(std::string file, bool unfinished = false)
      : file_(std::move(file)), unfinished_(unfinished) {}

  G2oFile read(std::string_view contents) {
    refuse_foreign(contents, file_, {FileKind::kG2o, FileKind::kEmpty}, kWanted);
    text::Lines lines(contents);
    for (std::string_view line; lines.next(line);) {
      line_ = lines.number();
      if (unfinished_ && !lines.ended() && !text::trim(line).empty()) {
        out_.problems.add_altered("unfinished last line left out", here());
      } else {
        read_line(line);
      }
    }
    if (out_.graph.empty()) {
      if (unfinished_ && !lines.ended()) return std::move(out_);
      throw InputError(file_ + (contents.empty() ? ": is empty, " : ": ") + "no VERTEX_SE3:QUAT line");
    }
    if (!unfinished_ && !lines.ended()) {
      out_.problems.add("no line end after the last line", here());
      refuse_cut_edge();
    }
    add_priors();
    add_edges();
    for (const auto& [tag, met] : unknown_tags_) {
      out_.problems.add_altered("unknown tag " + tag, text::Place{file_, met.first_line}.str(), met.count);
    }
    // Flaws of the odometry are counted by those who need it, and know the robots.
    static_cast<void>(classify_edges(out_.graph, Robots::from_keys(out_.graph.keys()), MissionOptions(),
                                     out_.without_information));
    return std::move(out_);
  }

 private:
  [[nodiscard]] text::Place place() const { return {file_, line_}; }
  [[nodiscard]] std::string here() const { return place().str(); }

  void read_line(std::string_view line) {
    const std::string_view tag = text::next_word(line);
    if (tag.empty()) return;
    if (tag == "EDGE_SE3:QUAT") {
      read_edge(tag, line);
    } else if (tag == "VERTEX_SE3:QUAT") {
      read_vertex(tag, line);
    } else if (tag == "EDGE_SE3_PRIOR") {
      PriorLine prior{line_, id(tag, line), id(tag, line), {}};
      numbers(tag, line, prior.numbers);
      priors_.push_back(prior);
    } else if (tag == "PARAMS_SE3OFFSET") {
      const Key parameter = id(tag, line);
      PoseNumbers values;
      numbers(tag, line, values);
      if (!offsets_.emplace(parameter, OffsetLine{line_, pose(values.data(), line_)}).second) {
        place().fail("parameter " + std::to_string(parameter) + " is defined twice, first in line " +
                     std::to_string(offsets_.at(parameter).line));
      }
    } else if (tag == "FIX") {
      fixed_.push_back({line_, id(tag, line)});
      for (std::string_view rest = line; !text::next_word(rest).empty(); rest = line) {
        fixed_.push_back({line_, id(tag, line)});
      }
    } else {
      read_other(tag, line);
    }
  }

  void read_edge(std::string_view tag, std::string_view line) {
    EdgeLine edge{line_, id(tag, line), id(tag, line), {}, true};
    const std::size_t found = text::read_numbers(line, edge.numbers.data(), kFactorNumbers, place());
    edge.has_information = found != kPoseNumbers;
    if (edge.has_information && found != kFactorNumbers) {
      place().fail(
          "EDGE_SE3:QUAT needs 28 values after the ids (7 of the pose, 21 of the information) or the "
          "7 alone, found " +
          std::to_string(found));
    }
    edges_.push_back(edge);
  }

  /// A last edge that lacks what all others have was cut, and its last number perhaps as well.
  void refuse_cut_edge() {
    if (edges_.empty() || edges_.back().line != line_ || edges_.back().has_information) return;
    const bool others_have = std::all_of(edges_.begin(), edges_.end() - 1,
                                         [](const EdgeLine& edge) { return edge.has_information; });
    if (edges_.size() == 1 || !others_have) return;
    place().fail(
        "EDGE_SE3:QUAT needs 28 values after the ids as the other edges have, found 7: the file is cut "
        "short");
  }

  void read_vertex(std::string_view tag, std::string_view line) {
    Node node;
    node.key = id(tag, line);
    VertexLine vertex{line_, {}};
    numbers(tag, line, vertex.numbers);
    if (const auto known = out_.graph.find(node.key)) {
      const VertexLine& first = vertices_[*known];
      if (first.numbers != vertex.numbers) {
        // Some writers leave the characters of keys out, so that the ids of several robots collide.
        const bool lost = key_character(node.key) == '\0';
        place().fail(
            "vertex " + std::to_string(node.key) + " has another pose in line " + std::to_string(first.line) +
            (lost ? ": if these are nodes of two robots, their ids lost the robots' characters; write "
                    "full 64-bit keys, or a file for each robot"
                  : ""));
      }
      out_.problems.add("repeated vertex", here() + ": " + std::to_string(node.key));
      return;
    }
    node.pose = pose(vertex.numbers.data(), line_);
    out_.graph.add_node(node);
    vertices_.push_back(vertex);
  }

  void read_other(std::string_view tag, std::string_view line) {
    static constexpr std::string_view kPlanar[] = {"VERTEX_SE2",     "EDGE_SE2", "VERTEX_XY", "EDGE_SE2_XY",
                                                   "EDGE_PRIOR_SE2", "VERTEX2",  "EDGE2"};
    static constexpr std::string_view kOtherForms[] = {"VERTEX3", "EDGE3", "VERTEX_SE3:EULER",
                                                       "EDGE_SE3:EULER"};
    if (std::find(std::begin(kPlanar), std::end(kPlanar), tag) != std::end(kPlanar)) {
      place().fail(std::string(tag) +
                   ": 2D pose graphs are not supported, expected VERTEX_SE3:QUAT and EDGE_SE3:QUAT");
    }
    if (std::find(std::begin(kOtherForms), std::end(kOtherForms), tag) != std::end(kOtherForms)) {
      place().fail(std::string(tag) +
                   ": Euler angles are not supported, expected VERTEX_SE3:QUAT and EDGE_SE3:QUAT");
    }
    const auto is_tag_character = [](char c) {
      return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_' ||
             c == ':';
    };
    const bool looks_like_tag =
        !(tag[0] >= '0' && tag[0] <= '9') && std::all_of(tag.begin(), tag.end(), is_tag_character);
    if (!looks_like_tag || (unknown_tags_.size() >= 100 && unknown_tags_.count(std::string(tag)) == 0)) {
      place().fail(text::quoted(tag) + " is no g2o tag; is this a g2o file?");
    }
    UnknownTag& met = unknown_tags_[std::string(tag)];
    if (met.count++ == 0) met.first_line = line_;
    Key key = 0;
    const bool is_vertex = tag.substr(0, 6) == "VERTEX";
    if (is_vertex && text::parse_id(text::next_word(line), key) == nullptr) other_vertices_.emplace(key, tag);
  }

  /// Whether a factor of this node cannot be used because the node is a vertex of a kind that is not read.
  bool hangs_on_other_vertex(std::string_view tag, std::size_t line, Key key) {
    const auto other = other_vertices_.find(key);
    if (other == other_vertices_.end() || out_.graph.contains(key)) return false;
    out_.problems.add_altered(std::string(tag) + " of " + other->second + " left out",
                              text::Place{file_, line}.str());
    return true;
  }

  /// Whether a factor to this node was written before the node was.
  bool hangs_on_missing_vertex(std::size_t line, Key key) {
    if (!unfinished_ || out_.graph.contains(key)) return false;
    out_.problems.add_altered("edge to a missing vertex left out",
                              text::Place{file_, line}.str() + ": vertex " + std::to_string(key));
    return true;
  }

  Key id(std::string_view tag, std::string_view& line) const {
    const std::string_view word = text::next_word(line);
    if (word.empty()) place().fail(std::string(tag) + ": id missing");
    Key key = 0;
    if (const char* why = text::parse_id(word, key)) {
      place().fail(std::string(tag) + ": id " + text::quoted(word) + " " + why);
    }
    return key;
  }

  template <std::size_t n>
  void numbers(std::string_view tag, std::string_view line, std::array<double, n>& values) const {
    const std::size_t found = text::read_numbers(line, values.data(), n, place());
    if (found != n) {
      place().fail(std::string(tag) + " needs " + std::to_string(n) + " values after the id" +
                   (n == kFactorNumbers ? "s (7 of the pose, 21 of the information)" : "") + ", found " +
                   std::to_string(found));
    }
  }

  Eigen::Isometry3d pose(const double* values, std::size_t line) {
    const text::Place at{file_, line};
    const text::Pose parsed = text::pose_of(values, at);
    if (!parsed.was_unit) out_.problems.add_altered("non-unit quaternion", at.str());
    return parsed.pose;
  }

  Matrix6d information(const double* triangle, std::size_t line) {
    Matrix6d out;
    for (int i = 0; i < 6; ++i) {
      for (int j = i; j < 6; ++j) out(i, j) = out(j, i) = *triangle++;
    }
    const SoundInformation sound = nearest_information(out);
    const std::string at = text::Place{file_, line}.str();
    if (sound.flaw == InformationFlaw::kRounded) out_.problems.add("rounded information", at);
    if (sound.flaw == InformationFlaw::kIndefinite) out_.problems.add_altered("indefinite information", at);
    return sound.matrix;
  }

  /// Nothing depends on a factor of zero information: it would only seem to tie its nodes.
  bool says_nothing(const Matrix6d& information, const char* what, std::size_t line) {
    if (!information.isZero(0.0)) return false;
    out_.problems.add_altered(std::string(what) + " of zero information left out",
                              text::Place{file_, line}.str());
    return true;
  }

  void add_priors() {
    for (const PriorLine& line : priors_) {
      if (hangs_on_other_vertex("EDGE_SE3_PRIOR", line.line, line.key)) continue;
      PriorFactor prior;
      prior.key = line.key;
      prior.pose = pose(line.numbers.data(), line.line);
      prior.information = information(line.numbers.data() + kPoseNumbers, line.line);
      if (says_nothing(prior.information, "prior", line.line)) continue;
      const auto offset = offsets_.find(line.parameter);
      if (offset == offsets_.end()) {
        text::Place{file_, line.line}.fail("parameter " + std::to_string(line.parameter) +
                                           " is not in the file");
      }
      // With sensor offset O, r = Log(Z⁻¹TO) = Ad(O⁻¹)·Log((ZO⁻¹)⁻¹T): a prior of the body itself.
      const Eigen::Isometry3d O_inverse = offset->second.offset.inverse();
      if (!O_inverse.matrix().isIdentity(0.0)) {
        prior.pose = prior.pose * O_inverse;
        prior.information = moved_information(prior.information, O_inverse);
      }
      add(line.line, [&] { out_.graph.add_prior(prior); });
    }
    for (const FixLine& line : fixed_) {
      if (hangs_on_other_vertex("FIX", line.line, line.key)) continue;
      out_.fixed.push_back(line.key);
      add(line.line, [&] {
        out_.graph.add_prior(
            {line.key, out_.graph.node(line.key).pose, Matrix6d::Identity() / (kFixedSigma * kFixedSigma)});
      });
    }
  }

  void add_edges() {
    std::unordered_map<std::uint64_t, std::size_t> seen;
    seen.reserve(edges_.size());
    for (std::size_t i = 0; i < edges_.size(); ++i) {
      const EdgeLine& line = edges_[i];
      const bool cannot_be_used = hangs_on_other_vertex("EDGE_SE3:QUAT", line.line, line.from) ||
                                  hangs_on_other_vertex("EDGE_SE3:QUAT", line.line, line.to) ||
                                  hangs_on_missing_vertex(line.line, line.from) ||
                                  hangs_on_missing_vertex(line.line, line.to);
      if (cannot_be_used) continue;
      Edge edge;
      edge.from = line.from;
      edge.to = line.to;
      edge.T_from_to = pose(line.numbers.data(), line.line);
      if (line.has_information) {
        edge.information = information(line.numbers.data() + kPoseNumbers, line.line);
        if (says_nothing(edge.information, "edge", line.line)) continue;
      } else {
        out_.without_information.push_back(out_.graph.edges().size());
        out_.problems.add_altered("edge without information", text::Place{file_, line.line}.str());
      }
      add(line.line, [&] { out_.graph.add_edge(edge); });

      const auto [first, is_new] = seen.emplace(hash(line), i);
      if (!is_new && same(edges_[first->second], line)) {
        out_.problems.add("repeated edge", text::Place{file_, line.line}.str() + ", first in line " +
                                               std::to_string(edges_[first->second].line));
      }
    }
  }

  static bool same(const EdgeLine& a, const EdgeLine& b) {
    return a.from == b.from && a.to == b.to && a.has_information == b.has_information &&
           a.numbers == b.numbers;
  }

  static std::uint64_t hash(const EdgeLine& edge) {
    std::uint64_t h = combine_seeds(edge.from, edge.to);
    for (const double number : edge.numbers) {
      const double value = number + 0.0;  // -0 and 0 compare equal, so must hash equal
      std::uint64_t bits = 0;
      std::memcpy(&bits, &value, sizeof(bits));
      h = mix64(h ^ bits);
    }
    return h;
  }

  /// The graph's own complaints, with the line that caused them.
  template <class Call>
  void add(std::size_t line, Call&& call) const {
    try {
      call();
    } catch (const InputError& error) {
      throw ParseError(file_, line, error.what());
    }
  }

  struct UnknownTag {
    std::size_t count = 0;
    std::size_t first_line = 0;
  };

  std::string file_;
  bool unfinished_;
  std::size_t line_ = 0;
  G2oFile out_;
  std::vector<VertexLine> vertices_;  // as the nodes of the graph
  std::vector<EdgeLine> edges_;
  std::vector<PriorLine> priors_;
  std::vector<FixLine> fixed_;
  std::map<Key, OffsetLine> offsets_;
  std::map<std::string, UnknownTag> unknown_tags_;
  std::unordered_map<Key, std::string> other_vertices_;  // tags of vertices that are not read
};

void append_information(std::string& out, const Matrix6d& information) {
  for (int i = 0; i < 6; ++i) {
    for (int j = i; j < 6; ++j) {
      out += ' ';
      text::append(out, information(i, j));
    }
  }
  out += '\n';
}

}  // namespace

std::string g2o_text(const PoseGraph& graph, const std::vector<PriorFactor>& priors) {
  std::string out;
  out.reserve(graph.nodes().size() * 160 + graph.edges().size() * 300);
  for (const Node& node : graph.nodes()) {
    out += "VERTEX_SE3:QUAT ";
    text::append(out, node.key);
    out += ' ';
    text::append_pose(out, node.pose);
    out += '\n';
  }
  if (!priors.empty()) out += "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n";
  for (const PriorFactor& prior : priors) {
    out += "EDGE_SE3_PRIOR ";
    text::append(out, prior.key);
    out += " 0 ";
    text::append_pose(out, prior.pose);
    append_information(out, prior.information);
  }
  for (const Edge& edge : graph.edges()) {
    out += "EDGE_SE3:QUAT ";
    text::append(out, edge.from);
    out += ' ';
    text::append(out, edge.to);
    out += ' ';
    text::append_pose(out, edge.T_from_to);
    append_information(out, edge.information);
  }
  return out;
}

G2oFile parse_g2o(std::string_view text, const std::string& source) {
  return Reader(source).read(text);
}

G2oFile parse_unfinished_g2o(std::string_view text, const std::string& source) {
  return Reader(source, true).read(text);
}

G2oFile read_g2o(const std::filesystem::path& path) {
  // Before all of a large recording is read.
  refuse_foreign_file(path, {FileKind::kG2o, FileKind::kEmpty}, kWanted);
  return parse_g2o(read_file(path), path.string());
}

void write_g2o(const std::filesystem::path& path, const PoseGraph& graph) {
  write_file(path, g2o_text(graph, graph.priors()));
}

}  // namespace loopwise
