// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>

namespace loopwise {

/// A cloud as it was read.
struct CloudFile {
  PointCloud cloud;   ///< Its points.
  Problems problems;  ///< Flaws that the reader could live with.
};

/// Reads .pcd (ascii, binary, binary_compressed), .ply (ascii, binary of either byte order) or KITTI .bin, by
/// extension. Fields may stand in any order and be any number type; x, y and z must be there, intensity and
/// normals are taken where present, the rest is skipped. An empty cloud is no error.
///
/// Counted in `problems`: "point not finite" and "point out of range" (beyond 1e7 m; both dropped), "unusable
/// normals" (one that is not of unit length spoils the field, which is then left out: many programs write
/// zeros), "intensity not finite" (set to 0), "viewpoint ignored", "empty file" (.bin), "no line end after
/// the last line" (ascii). Normals are turned towards the sensor.
///
/// The sizes that a header claims are held against the length of the file before any memory is taken.
/// \throws IoError; InputError naming the file (for the lines of ascii data: ParseError) if it is cut short,
/// its counts disagree, or its kind is not known.
[[nodiscard]] LOOPWISE_EXPORT CloudFile read_cloud(const std::filesystem::path& path);

/// Whether read_cloud() knows the extension.
[[nodiscard]] LOOPWISE_EXPORT bool is_cloud_file(const std::filesystem::path& path);

/// How the points stand in a PCD file.
enum class PcdEncoding {
  kAscii,             ///< Numbers as text, a point a line.
  kBinary,            ///< Point by point as in memory.
  kBinaryCompressed,  ///< Field by field, compressed by LZF.
};
[[nodiscard]] inline EnumNames<PcdEncoding> enum_names(PcdEncoding) {
  return {{PcdEncoding::kAscii, "ascii"},
          {PcdEncoding::kBinary, "binary"},
          {PcdEncoding::kBinaryCompressed, "binary_compressed"}};
}

/// PCD 0.7 with the fields that the cloud has; read_cloud() and PCL give back the same floats in every
/// encoding. Replaces an existing file as a whole or not at all, see write_file(). \throws IoError
LOOPWISE_EXPORT void write_pcd(const std::filesystem::path& path, const PointCloud& cloud,
                               PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

/// Binary little-endian PLY with the fields that the cloud has, written likewise. \throws IoError
LOOPWISE_EXPORT void write_ply(const std::filesystem::path& path, const PointCloud& cloud);

}  // namespace loopwise
