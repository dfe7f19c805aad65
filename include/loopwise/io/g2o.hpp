// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/pose_graph.hpp>
#include <loopwise/core/problems.hpp>

namespace loopwise {

/// A graph as it was read.
struct G2oFile {
  PoseGraph graph;  ///< Nodes, priors and edges in the order of the file.
  /// Numbers of the edges for which the file has no information. They got that which
  /// classify_edges() gives them by MissionOptions as it stands.
  std::vector<std::size_t> without_information;
  std::vector<Key> fixed;  ///< Nodes of `FIX` lines, whose priors the graph has.
  Problems problems;       ///< Flaws that the reader could live with.
};

/// Reads a 3D or 2D pose graph. Ids are full 64-bit keys; nodes, priors and edges keep the order of the file;
/// an edge may stand before its vertices. What is understood:
///
/// - `VERTEX_SE3:QUAT key x y z qx qy qz qw`
/// - `EDGE_SE3:QUAT from to x y z qx qy qz qw` and 21 numbers: Ω's upper triangle by rows
///   (translation first); or no further number, see G2oFile::without_information
/// - `EDGE_SE3_PRIOR key parameter x y z qx qy qz qw` and 21 numbers; a sensor's offset is folded in
/// - `PARAMS_SE3OFFSET parameter x y z qx qy qz qw`
/// - `FIX key...`, which becomes a prior at the vertex's pose with sigma 1e-4 m and rad
/// - `VERTEX_SE2 key x y θ`
/// - `EDGE_SE2 from to x y θ` and 6 numbers: Ω's upper triangle by rows (x, y, θ); or no further number
/// - `EDGE_PRIOR_SE2 key x y θ` and 6 numbers
///
/// The last three make a planar graph (see PoseGraph). A file holds tags of 3D or of 2D, never both.
///
/// Text from '#' to the end of its line is a comment; CRLF line ends, tabs and trailing blanks do no harm.
/// Edges have the kinds that classify_edges() gives them with the robots of Robots::from_keys(). Its flaws
/// are not counted, since a graph may hold poses alone: a caller that needs odometry, or knows its robots
/// better, calls it again.
///
/// Counted in `problems`: "repeated vertex" and "repeated edge" (the same in every number; the edge is kept,
/// and so counts twice), "rounded information"
/// (indefinite by no more than six printed digits explain; its negative eigenvalues are raised to 0),
/// "no line end after the last line" (the file may have been cut short). Counted as altered: "non-unit
/// quaternion" (off by more than 1e-3; normalised), "indefinite information" (beyond that; replaced by the
/// nearest semi-definite matrix), "edge without information", "edge from a vertex to itself left out", "edge
/// of zero information left out" (it ties its nodes by nothing), "prior of zero information left out",
/// "unknown tag TAG", and factors at vertices of such a tag: "FIX of TAG left out", "EDGE_SE3:QUAT of TAG
/// left out", "EDGE_SE3_PRIOR of TAG left out" (in a 2D graph EDGE_SE2 and EDGE_PRIOR_SE2).
///
/// \throws IoError if the file cannot be read; ParseError naming the line for a wrong number of values, a
/// number that is not finite, a zero quaternion, an id that is negative or exceeds 64 bits, a vertex with two
/// different poses, an edge to a vertex that is not in the file, tags of 2D and 3D in one file; InputError
/// if there is no vertex at all, or if the file is of another kind, which it names.
[[nodiscard]] LOOPWISE_EXPORT G2oFile read_g2o(const std::filesystem::path& path);

/// The same of a text in memory; `source` stands in errors and problems for the file's name.
[[nodiscard]] LOOPWISE_EXPORT G2oFile parse_g2o(std::string_view text, const std::string& source);

/// Writes nodes, priors and edges so that read_g2o() gives them back: keys and information exactly, poses to
/// rounding. A planar graph is written by the tags of 2D; of its information, what is within the plane.
/// Stamps, covariances, weights and kinds have no place in the format. An existing file is replaced as a
/// whole or not at all. \throws IoError
LOOPWISE_EXPORT void write_g2o(const std::filesystem::path& path, const PoseGraph& graph);

}  // namespace loopwise
