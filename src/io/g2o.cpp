// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/g2o.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <optional>
#include <set>
#include <unordered_map>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/planar.hpp>
#include <loopwise/core/priors.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "file_kind.hpp"
#include "g2o_text.hpp"
#include "information.hpp"
#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

constexpr const char* kWantedGraph = "a g2o graph";
constexpr std::size_t kPoseNumbers = 7;
constexpr std::size_t kFactorNumbers = 28;  // a pose and the upper triangle of a 6x6 matrix

using PoseNumbers = std::array<double, kPoseNumbers>;
using FactorNumbers = std::array<double, kFactorNumbers>;

/// Tags and sizes of a file. It has poses and factors either of SE(3) or of the plane.
struct Form {
  std::string_view vertex, edge, prior;
  std::size_t pose_numbers, factor_numbers;  // a factor has a pose and the upper triangle of its information
};
constexpr Form kSpatial{"VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "EDGE_SE3_PRIOR", kPoseNumbers, kFactorNumbers};
constexpr Form kPlanar{"VERTEX_SE2", "EDGE_SE2", "EDGE_PRIOR_SE2", 3, 9};

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

class GraphReader {
 public:
  explicit GraphReader(std::string file, bool unfinished = false)
      : file_(std::move(file)), unfinished_(unfinished) {}

  G2oFile read(std::string_view contents) {
    refuse_foreign(contents, file_, {FileKind::kG2o, FileKind::kEmpty}, kWantedGraph);
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
      throw InputError(file_ + (contents.empty() ? ": is empty, " : ": ") +
                       "no VERTEX_SE3:QUAT or VERTEX_SE2 line");
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
    // Problems of the odometry are counted by the callers, which know the robots.
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
    if (const Form* form = form_of(tag)) {
      require_form(tag, *form);
      if (tag == form->edge) {
        read_edge(tag, line);
      } else if (tag == form->vertex) {
        read_vertex(tag, line);
      } else {
        PriorLine prior{line_, id(tag, line), 0, {}};
        if (form == &kSpatial) prior.parameter = id(tag, line);
        numbers(tag, line, prior.numbers, form->factor_numbers);
        priors_.push_back(prior);
      }
    } else if (tag == "PARAMS_SE3OFFSET") {
      require_form(tag, kSpatial);
      const Key parameter = id(tag, line);
      PoseNumbers values;
      numbers(tag, line, values, kPoseNumbers);
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

  static const Form* form_of(std::string_view tag) {
    for (const Form* form : {&kSpatial, &kPlanar}) {
      if (tag == form->vertex || tag == form->edge || tag == form->prior) return form;
    }
    return nullptr;
  }

  /// The first line that has a form decides the form of the file.
  void require_form(std::string_view tag, const Form& form) {
    if (form_ == nullptr) {
      form_ = &form;
      first_of_form_ = std::string(tag) + " in line " + std::to_string(line_);
      out_.graph.set_planar(&form == &kPlanar);
    } else if (form_ != &form) {
      place().fail(std::string(tag) + " in the file of a " + (form_ == &kPlanar ? "2D" : "3D") + " graph (" +
                   first_of_form_ + "): write 2D and 3D graphs to separate files");
    }
  }

  void read_edge(std::string_view tag, std::string_view line) {
    EdgeLine edge{line_, id(tag, line), id(tag, line), {}, true};
    const std::size_t found = text::read_numbers(line, edge.numbers.data(), form_->factor_numbers, place());
    edge.has_information = found != form_->pose_numbers;
    if (edge.has_information && found != form_->factor_numbers) {
      place().fail(needs(tag, "the ids", form_->factor_numbers) + " or the " +
                   std::to_string(form_->pose_numbers) + " alone, found " + std::to_string(found));
    }
    edges_.push_back(edge);
  }

  /// Refuses a last edge that has no information although all other edges have it: the line was cut off, and
  /// perhaps within its last number.
  void refuse_cut_edge() {
    if (edges_.empty() || edges_.back().line != line_ || edges_.back().has_information) return;
    const bool others_have = std::all_of(edges_.begin(), edges_.end() - 1,
                                         [](const EdgeLine& edge) { return edge.has_information; });
    if (edges_.size() == 1 || !others_have) return;
    place().fail(std::string(form_->edge) + " needs " + std::to_string(form_->factor_numbers) +
                 " values after the ids as the other edges have, found " +
                 std::to_string(form_->pose_numbers) + ": the file is cut short");
  }

  void read_vertex(std::string_view tag, std::string_view line) {
    Node node;
    node.key = id(tag, line);
    VertexLine vertex{line_, {}};
    numbers(tag, line, vertex.numbers, form_->pose_numbers);
    if (const auto known = out_.graph.find(node.key)) {
      const VertexLine& first = vertices_[*known];
      if (first.numbers != vertex.numbers) {
        // Some writers drop the characters of keys, so that ids of several robots are equal.
        const bool lost = key_character(node.key) == '\0';
        place().fail(
            "vertex " + std::to_string(node.key) + " has another pose in line " + std::to_string(first.line) +
            (lost ? ": if these are nodes of two robots, their ids lack the robots' characters; write "
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
    if (tag == "VERTEX2" || tag == "EDGE2") {
      place().fail(std::string(tag) +
                   ": programs differ in the direction and the order of numbers of this tag, expected "
                   "VERTEX_SE2 and EDGE_SE2 (from, to, pose, information by rows)");
    }
    static constexpr std::string_view kOtherForms[] = {"VERTEX3", "EDGE3", "VERTEX_SE3:EULER",
                                                       "EDGE_SE3:EULER"};
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
      place().fail("unknown g2o tag " + text::quoted(tag) + "; is this a g2o file?");
    }
    UnknownTag& met = unknown_tags_[std::string(tag)];
    if (met.count++ == 0) met.first_line = line_;
    Key key = 0;
    const bool is_vertex = tag.substr(0, 6) == "VERTEX";
    if (is_vertex && text::parse_id(text::next_word(line), key) == nullptr) other_vertices_.emplace(key, tag);
  }

  /// Whether a factor is unusable because its node is a vertex of a kind that is not read.
  bool has_unsupported_vertex(std::string_view tag, std::size_t line, Key key) {
    const auto other = other_vertices_.find(key);
    if (other == other_vertices_.end() || out_.graph.contains(key)) return false;
    out_.problems.add_altered(std::string(tag) + " of " + other->second + " left out",
                              text::Place{file_, line}.str());
    return true;
  }

  /// Whether a factor in an unfinished file precedes its node, which was never written.
  bool has_missing_vertex(std::size_t line, Key key) {
    if (!unfinished_ || out_.graph.contains(key)) return false;
    out_.problems.add_altered("edge to a missing vertex left out",
                              text::Place{file_, line}.str() + ": vertex " + std::to_string(key));
    return true;
  }

  /// Whether the edge joins a vertex to itself. Place recognition may find the current place of the robot.
  bool is_self_loop(const EdgeLine& line) {
    if (line.from != line.to || !out_.graph.contains(line.from)) return false;
    out_.problems.add_altered("edge from a vertex to itself left out",
                              text::Place{file_, line.line}.str() + ": vertex " + std::to_string(line.from));
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

  static std::string needs(std::string_view tag, const char* after, std::size_t count) {
    std::string out = std::string(tag) + " needs " + std::to_string(count) + " values after " + after;
    for (const Form& form : {kSpatial, kPlanar}) {
      if (count != form.factor_numbers) continue;
      out += " (" + std::to_string(form.pose_numbers) + " of the pose, " +
             std::to_string(form.factor_numbers - form.pose_numbers) + " of the information)";
    }
    return out;
  }

  /// The first `count` of the values.
  template <std::size_t n>
  void numbers(std::string_view tag, std::string_view line, std::array<double, n>& values,
               std::size_t count) const {
    const std::size_t found = text::read_numbers(line, values.data(), count, place());
    if (found == count) return;
    const char* after = tag == kSpatial.prior ? "the ids" : "the id";
    place().fail(needs(tag, after, count) + ", found " + std::to_string(found));
  }

  Eigen::Isometry3d pose(const double* values, std::size_t line) {
    if (form_ == &kPlanar) return planar::pose(values[0], values[1], values[2]);
    const text::Place at{file_, line};
    const text::Pose parsed = text::pose_of(values, at);
    if (!parsed.was_unit) out_.problems.add_altered("non-unit quaternion", at.str());
    return parsed.pose;
  }

  template <int n>
  static Eigen::Matrix<double, n, n> symmetric(const double* triangle) {
    Eigen::Matrix<double, n, n> out;
    for (int i = 0; i < n; ++i) {
      for (int j = i; j < n; ++j) out(i, j) = out(j, i) = *triangle++;
    }
    return out;
  }

  Matrix6d information(const std::array<double, kFactorNumbers>& numbers, std::size_t line) {
    const double* triangle = numbers.data() + form_->pose_numbers;
    const bool planar = form_ == &kPlanar;
    const SoundInformation sound =
        nearest_information(planar ? planar::information(symmetric<3>(triangle)) : symmetric<6>(triangle));
    const std::string at = text::Place{file_, line}.str();
    if (sound.flaw == InformationFlaw::kRounded) out_.problems.add("rounded information", at);
    if (sound.flaw == InformationFlaw::kIndefinite) out_.problems.add_altered("indefinite information", at);
    if (!planar) return sound.matrix;
    // The decomposition leaves rounding errors between the plane and the other coordinates.
    return planar::information(planar::block(sound.matrix));
  }

  /// A factor of zero information has no effect, but would seem to connect its nodes.
  bool is_uninformative(const Matrix6d& information, const char* what, std::size_t line) {
    if (!information.isZero(0.0)) return false;
    out_.problems.add_altered(std::string(what) + " of zero information left out",
                              text::Place{file_, line}.str());
    return true;
  }

  void add_priors() {
    for (const PriorLine& line : priors_) {
      if (has_unsupported_vertex(form_->prior, line.line, line.key)) continue;
      PriorFactor prior;
      prior.key = line.key;
      prior.pose = pose(line.numbers.data(), line.line);
      prior.information = information(line.numbers, line.line);
      if (is_uninformative(prior.information, "prior", line.line)) continue;
      if (form_ == &kSpatial) fold_offset(line, prior);
      add(line.line, [&] { out_.graph.add_prior(prior); });
    }
    for (const FixLine& line : fixed_) {
      if (has_unsupported_vertex("FIX", line.line, line.key)) continue;
      out_.fixed.push_back(line.key);
      add(line.line, [&] { out_.graph.add_prior(prior_at(out_.graph, line.key)); });
    }
  }

  /// With sensor offset O, r = Log(Z⁻¹TO) = Ad(O⁻¹)·Log((ZO⁻¹)⁻¹T), which is a prior of the body itself.
  void fold_offset(const PriorLine& line, PriorFactor& prior) const {
    const auto offset = offsets_.find(line.parameter);
    if (offset == offsets_.end()) {
      text::Place{file_, line.line}.fail("parameter " + std::to_string(line.parameter) +
                                         " is not defined by a PARAMS_SE3OFFSET line");
    }
    const Eigen::Isometry3d O_inverse = offset->second.offset.inverse();
    if (O_inverse.matrix().isIdentity(0.0)) return;
    prior.pose = prior.pose * O_inverse;
    prior.information = moved_information(prior.information, O_inverse);
  }

  void add_edges() {
    std::unordered_map<std::uint64_t, std::size_t> seen;
    seen.reserve(edges_.size());
    for (std::size_t i = 0; i < edges_.size(); ++i) {
      const EdgeLine& line = edges_[i];
      const bool cannot_be_used = has_unsupported_vertex(form_->edge, line.line, line.from) ||
                                  has_unsupported_vertex(form_->edge, line.line, line.to) ||
                                  has_missing_vertex(line.line, line.from) ||
                                  has_missing_vertex(line.line, line.to) || is_self_loop(line);
      if (cannot_be_used) continue;
      Edge edge;
      edge.from = line.from;
      edge.to = line.to;
      edge.T_from_to = pose(line.numbers.data(), line.line);
      if (line.has_information) {
        edge.information = information(line.numbers, line.line);
        if (is_uninformative(edge.information, "edge", line.line)) continue;
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

  /// Adds the line to errors of the graph.
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
  const Form* form_ = nullptr;
  std::string first_of_form_;  // tag and line
  G2oFile out_;
  std::vector<VertexLine> vertices_;  // as the nodes of the graph
  std::vector<EdgeLine> edges_;
  std::vector<PriorLine> priors_;
  std::vector<FixLine> fixed_;
  std::map<Key, OffsetLine> offsets_;
  std::map<std::string, UnknownTag> unknown_tags_;
  std::unordered_map<Key, std::string> other_vertices_;  // tags of vertices that are not read
};

template <class Matrix>
void append_triangle(std::string& out, const Matrix& m) {
  for (int i = 0; i < m.rows(); ++i) {
    for (int j = i; j < m.cols(); ++j) {
      out += ' ';
      text::append(out, m(i, j));
    }
  }
}

/// An angle near this one whose rotation matrix is exactly R, with few digits if possible.
std::optional<double> angle_of(double angle, const Eigen::Matrix3d& R) {
  constexpr int kRounding = 4;  // atan2 may be off by as many of the last bits
  const auto fits = [&R](double value) { return planar::pose(0.0, 0.0, value).linear() == R; };
  char digits[40];
  // An angle that was written with up to 15 digits is printed with the same digits.
  for (int precision = 15; precision <= 17; ++precision) {
    const int length = std::snprintf(digits, sizeof digits, "%.*g", precision, angle);
    const std::string_view word(digits, static_cast<std::size_t>(length));
    double value = 0.0;
    if (text::parse_double(word, value) == text::Number::kOk && fits(value)) return value;
  }
  double up = angle, down = angle;
  for (int i = 0; i < kRounding; ++i) {
    up = std::nextafter(up, 4.0);
    down = std::nextafter(down, -4.0);
    if (fits(up)) return up;
    if (fits(down)) return down;
  }
  return std::nullopt;
}

/// Writes the heading in the digits that give the same rotation matrix. If no angle gives this matrix
/// exactly, writes its heading.
void append_heading(std::string& out, const Eigen::Isometry3d& T) {
  const double angle = planar::heading(T);
  auto same = angle_of(angle, T.linear());
  if (!same) {
    const Eigen::Isometry3d near = planar::pose(0.0, 0.0, angle);
    same = angle_of(planar::heading(near), near.linear());
  }
  text::append(out, same.value_or(angle));
}

/// Writes lines of a graph in 2D or 3D form.
class Writer {
 public:
  explicit Writer(bool planar) : planar_(planar), form_(planar ? kPlanar : kSpatial) {}

  void vertex(const Node& node) {
    begin(form_.vertex, node.key);
    pose(node.pose);
    out += '\n';
  }
  void prior(const PriorFactor& prior) {
    begin(form_.prior, prior.key);
    if (!planar_) out += "0 ";
    pose(prior.pose);
    information(prior.information);
  }
  void edge(const Edge& edge) {
    begin(form_.edge, edge.from);
    text::append(out, edge.to);
    out += ' ';
    pose(edge.T_from_to);
    information(edge.information);
  }

  std::string out;

 private:
  void begin(std::string_view tag, Key key) {
    out += tag;
    out += ' ';
    text::append(out, key);
    out += ' ';
  }
  void pose(const Eigen::Isometry3d& T) {
    if (!planar_) return text::append_pose(out, T);
    for (int axis = 0; axis < 2; ++axis) {
      text::append(out, T.translation()[axis]);
      out += ' ';
    }
    append_heading(out, T);
  }
  void information(const Matrix6d& m) {
    if (planar_) {
      append_triangle(out, planar::block(m));
    } else {
      append_triangle(out, m);
    }
    out += '\n';
  }

  bool planar_;
  Form form_;
};

}  // namespace

std::string g2o_text(const PoseGraph& graph, const std::vector<PriorFactor>& priors) {
  Writer to(graph.planar());
  to.out.reserve(graph.nodes().size() * 160 + graph.edges().size() * 300);
  for (const Node& node : graph.nodes()) to.vertex(node);
  if (!priors.empty() && !graph.planar()) to.out += "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n";
  for (const PriorFactor& prior : priors) to.prior(prior);
  for (const Edge& edge : graph.edges()) to.edge(edge);
  return std::move(to.out);
}

G2oFile parse_g2o(std::string_view text, const std::string& source) {
  return GraphReader(source).read(text);
}

G2oFile parse_unfinished_g2o(std::string_view text, const std::string& source) {
  return GraphReader(source, true).read(text);
}

G2oFile read_g2o(const std::filesystem::path& path) {
  // Checked before a large recording is read as a whole.
  refuse_foreign_file(path, {FileKind::kG2o, FileKind::kEmpty}, kWantedGraph);
  return parse_g2o(read_file(path), path.string());
}

void write_g2o(const std::filesystem::path& path, const PoseGraph& graph) {
  write_file(path, g2o_text(graph, graph.priors()));
}

}  // namespace loopwise
