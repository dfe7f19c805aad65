// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/point_cloud.hpp>

#include <algorithm>

namespace loopwise {
namespace {

[[noreturn]] void fail(const std::string& why) {
  throw InputError("PointBuffer: " + why);
}

}  // namespace

PointView::PointView(const PointBuffer& buffer) : size_(buffer.points) {
  const std::size_t width = buffer.type == CoordinateType::kFloat ? sizeof(float) : sizeof(double);
  kind_ = buffer.type == CoordinateType::kFloat ? Kind::kFloats : Kind::kDoubles;
  if (buffer.points == 0 && buffer.bytes == 0) return;
  const std::size_t last = *std::max_element(buffer.offsets.begin(), buffer.offsets.end());
  if (buffer.stride < width || last > buffer.stride - width) {
    fail("stride = " + std::to_string(buffer.stride) + " bytes, but a coordinate of " +
         std::to_string(width) + " bytes begins at " + std::to_string(last) +
         ": set stride to point_step, and offsets to those of x, y, z");
  }
  if (buffer.bytes % buffer.stride != 0 || buffer.bytes / buffer.stride != buffer.points) {
    fail(std::to_string(buffer.points) + " points with a stride of " + std::to_string(buffer.stride) +
         " bytes do not fill " + std::to_string(buffer.bytes) +
         " bytes: set points to width · height and stride to point_step, and copy rows that have padding");
  }
  if (buffer.data == nullptr) fail("data is null");
  const auto* data = static_cast<const unsigned char*>(buffer.data);
  const auto offset = [&](std::size_t axis) { return static_cast<std::ptrdiff_t>(buffer.offsets[axis]); };
  data_ = data + offset(0);
  stride_ = static_cast<std::ptrdiff_t>(buffer.stride);
  y_ = offset(1) - offset(0);
  z_ = offset(2) - offset(0);
}

PointNormalView::PointNormalView(PointView points, PointView normals) : points_(points), normals_(normals) {
  if (points.size() != normals.size()) {
    throw InputError(std::to_string(points.size()) + " points with " + std::to_string(normals.size()) +
                     " normals: each point needs a normal, see estimate_normals()");
  }
}

namespace detail {

void check_precision(PointView points, const char* what) {
  if (points.is_single()) return;
  constexpr double kCoarse_m = 16384.0;  // floats beyond are at least 2 mm apart
  std::size_t finite = 0, coarse = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d point = points[i];
    if (!point.allFinite()) continue;
    ++finite;
    if (point.cwiseAbs().maxCoeff() > kCoarse_m) ++coarse;
  }
  if (2 * coarse > finite) {
    throw InputError(
        std::string(what) +
        " is in world coordinates, where a float loses digits: subtract an offset from its points, "
        "as voxel_downsample() does");
  }
}

}  // namespace detail

}  // namespace loopwise
