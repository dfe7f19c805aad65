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

/// A graph from a file.
struct G2oFile {
  PoseGraph graph;  ///< Nodes, priors and edges in the order of the file.
  /// Numbers of the edges without information in the file. They have the information that classify_edges()
  /// gives them with default MissionOptions.
  std::vector<std::size_t> without_information;
  std::vector<Key> fixed;  ///< Nodes of `FIX` lines, whose priors the graph has.
  Problems problems;       ///< Tolerable flaws.
};

/// Reads a 3D or 2D pose graph. Ids are full 64-bit keys; nodes, priors and edges keep the order of the file;
/// an edge may precede its vertices. Supported lines:
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
/// Text from '#' to the end of its line is a comment; CRLF line ends, tabs and trailing blanks are allowed.
/// classify_edges() sets the kinds of the edges with the robots of Robots::from_keys(). Its flaws are not
/// counted, since a graph may have no odometry; a caller that needs odometry, or has other robots, calls it
/// again.
///
/// Counted in `problems`: "repeated vertex" and "repeated edge" (the same in every number; the edge is kept,
/// and so counts twice), "rounded information" (indefinite within the rounding of six printed digits;
/// negative eigenvalues are raised to 0), "no line end after the last line" (the file may be truncated).
/// Counted as altered: "non-unit quaternion" (off by more than 1e-3; normalised), "indefinite information"
/// (beyond that; replaced by the nearest semi-definite matrix), "edge without information", "edge from a
/// vertex to itself left out", "edge of zero information left out" (it does not constrain its nodes), "prior
/// of zero information left out", "unknown tag TAG", and factors at vertices of such a tag: "FIX of TAG left
/// out", "EDGE_SE3:QUAT of TAG left out", "EDGE_SE3_PRIOR of TAG left out" (in a 2D graph EDGE_SE2 and
/// EDGE_PRIOR_SE2).
///
/// \throws IoError if the file cannot be read; ParseError naming the line for a wrong number of values, a
/// number that is not finite, a zero quaternion, an id that is negative or exceeds 64 bits, a vertex with two
/// different poses, an edge to a vertex that is not in the file, tags of 2D and 3D in one file; InputError if
/// there is no vertex, or if the file is of another kind, which the message names.
[[nodiscard]] LOOPWISE_EXPORT G2oFile read_g2o(const std::filesystem::path& path);

/// The same for a text in memory; `source` replaces the file's name in errors and problems.
[[nodiscard]] LOOPWISE_EXPORT G2oFile parse_g2o(std::string_view text, const std::string& source);

/// Writes nodes, priors and edges; read_g2o() reads keys and information exactly, poses to rounding. A planar
/// graph is written with the tags of 2D and the information within the plane. The format cannot hold stamps,
/// covariances, weights and kinds. An existing file is replaced as a whole or not at all. \throws IoError
LOOPWISE_EXPORT void write_g2o(const std::filesystem::path& path, const PoseGraph& graph);

}  // namespace loopwise
