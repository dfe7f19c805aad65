// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>

namespace loopwise {

/// A cloud from a file.
struct CloudFile {
  PointCloud cloud;   ///< Its points.
  Problems problems;  ///< Tolerable flaws.
};

/// Fields of a point in a .bin file, which has no header. Numbers are little-endian, without gaps, and of 32
/// bits unless stated otherwise.
enum class BinLayout {
  kAuto,          ///< xyzi, if the values are plausible.
  kXyz,           ///< 3 floats, 12 bytes.
  kXyzi,          ///< 4 floats, 16 bytes: KITTI, MulRan.
  kXyzir,         ///< 5 floats, 20 bytes, the last is the ring: nuScenes.
  kXyzirt,        ///< 6 floats, 24 bytes: with ring and time.
  kXyzDouble,     ///< 3 doubles, 24 bytes.
  kXyziDouble,    ///< 4 doubles, 32 bytes.
  kHeliprOuster,  ///< HeLiPR, 26 bytes: 4 floats, time, reflectivity, ring and ambient light (16 bits each).
  kHeliprVelodyne,       ///< HeLiPR, 22 bytes: 4 floats, ring (16 bits), time.
  kHeliprAvia,           ///< HeLiPR, 19 bytes: 3 floats, reflectivity, tag and line (8 bits each), time.
  kHeliprAeva,           ///< HeLiPR, 25 bytes: 3 floats, reflectivity, velocity, time, line (8 bits).
  kHeliprAevaIntensity,  ///< HeLiPR's later sequences, 29 bytes: the same and the intensity.
};
[[nodiscard]] inline EnumNames<BinLayout> enum_names(BinLayout) {
  return {{BinLayout::kAuto, "auto"},
          {BinLayout::kXyz, "xyz"},
          {BinLayout::kXyzi, "xyzi"},
          {BinLayout::kXyzir, "xyzir"},
          {BinLayout::kXyzirt, "xyzirt"},
          {BinLayout::kXyzDouble, "xyz_double"},
          {BinLayout::kXyziDouble, "xyzi_double"},
          {BinLayout::kHeliprOuster, "helipr_ouster"},
          {BinLayout::kHeliprVelodyne, "helipr_velodyne"},
          {BinLayout::kHeliprAvia, "helipr_avia"},
          {BinLayout::kHeliprAeva, "helipr_aeva"},
          {BinLayout::kHeliprAevaIntensity, "helipr_aeva_intensity"}};
}

/// Reads .pcd (ascii, binary, binary_compressed), .ply (ascii, binary of either byte order) or .bin, by
/// extension. Fields may have any order and number type. x, y and z are required, intensity and normals are
/// optional, other fields are skipped. An empty cloud is not an error.
///
/// If the median of the points is further than 300 m from zero, their coordinates are not those of a sensor:
/// PointCloud::origin is then the median, in whole metres. An origin in a comment of write_pcd() or
/// write_ply() is used as well.
///
/// Files without a header have the layout `bin_layout`. With kAuto, implausible values for x, y, z and
/// intensity are an error that names the probable layout.
///
/// Counted in `problems`: "point not finite" and "point out of range" (beyond 1e7 m; both dropped), "unusable
/// normals" (if one is not of unit length, the field is left out: many programs write zeros), "intensity not
/// finite" (set to 0), "viewpoint ignored", "empty file" (.bin), "points that do not fit the layout" (.bin),
/// "point rounded to a float far from zero" (beyond 16 km floats are 2 mm apart or more; counted if this
/// applies to most points), "no line end after the last line" (ascii). Normals are oriented towards the
/// sensor, which is assumed at PointCloud::origin.
///
/// The sizes in a header are compared with the length of the file before any allocation.
/// \throws IoError; InputError naming the file (for the lines of ascii data: ParseError) if it is truncated,
/// its counts disagree, or its kind is unknown.
[[nodiscard]] LOOPWISE_EXPORT CloudFile read_cloud(const std::filesystem::path& path,
                                                   BinLayout bin_layout = BinLayout::kAuto);

/// Whether read_cloud() supports the extension.
[[nodiscard]] LOOPWISE_EXPORT bool is_cloud_file(const std::filesystem::path& path);

/// Encoding of the points in a PCD file.
enum class PcdEncoding {
  kAscii,             ///< Numbers as text, one point a line.
  kBinary,            ///< Point by point as in memory.
  kBinaryCompressed,  ///< Field by field, compressed by LZF.
};
[[nodiscard]] inline EnumNames<PcdEncoding> enum_names(PcdEncoding) {
  return {{PcdEncoding::kAscii, "ascii"},
          {PcdEncoding::kBinary, "binary"},
          {PcdEncoding::kBinaryCompressed, "binary_compressed"}};
}

/// Writes PCD 0.7 with the fields of the cloud; read_cloud() and PCL read the same floats in every encoding.
/// A non-zero origin is written as a comment: `# loopwise origin X Y Z`. Replaces an existing file as a whole
/// or not at all, see write_file(). \throws IoError
LOOPWISE_EXPORT void write_pcd(const std::filesystem::path& path, const PointCloud& cloud,
                               PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

/// Writes binary little-endian PLY with the fields of the cloud, in the same way. \throws IoError
LOOPWISE_EXPORT void write_ply(const std::filesystem::path& path, const PointCloud& cloud);

}  // namespace loopwise
