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

/// What a point is made of in a .bin file, which has no header. Numbers are little-endian, of 32 bits unless
/// said otherwise, without gaps.
enum class BinLayout {
  kAuto,          ///< xyzi, if the values look like it.
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
/// extension. Fields may stand in any order and be any number type; x, y and z must be there, intensity and
/// normals are taken where present, the rest is skipped. An empty cloud is no error.
///
/// Where the middle of the points is further than 300 m from zero, they are in other coordinates than a
/// sensor's: PointCloud::origin is then their middle, in whole metres. So is the origin that write_pcd() and
/// write_ply() state in a comment.
///
/// Files without a header are read as `bin_layout` says. Without one, values that do not look like x, y, z
/// and intensity are an error that says what they look like.
///
/// Counted in `problems`: "point not finite" and "point out of range" (beyond 1e7 m; both dropped), "unusable
/// normals" (one that is not of unit length spoils the field, which is then left out: many programs write
/// zeros), "intensity not finite" (set to 0), "viewpoint ignored", "empty file" (.bin), "points unlike the
/// layout" (.bin), "point rounded to a float far from zero" (more than 16 km away floats are 2 mm apart or
/// more; if most points are such), "no line end after the last line" (ascii). Normals are turned towards the
/// sensor, which is taken to stand at PointCloud::origin.
///
/// The sizes that a header claims are held against the length of the file before any memory is taken.
/// \throws IoError; InputError naming the file (for the lines of ascii data: ParseError) if it is cut short,
/// its counts disagree, or its kind is not known.
[[nodiscard]] LOOPWISE_EXPORT CloudFile read_cloud(const std::filesystem::path& path,
                                                   BinLayout bin_layout = BinLayout::kAuto);

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
/// encoding. An origin that is not zero stands in a comment: `# loopwise origin X Y Z`. Replaces an existing
/// file as a whole or not at all, see write_file(). \throws IoError
LOOPWISE_EXPORT void write_pcd(const std::filesystem::path& path, const PointCloud& cloud,
                               PcdEncoding encoding = PcdEncoding::kBinaryCompressed);

/// Binary little-endian PLY with the fields that the cloud has, written likewise. \throws IoError
LOOPWISE_EXPORT void write_ply(const std::filesystem::path& path, const PointCloud& cloud);

}  // namespace loopwise
