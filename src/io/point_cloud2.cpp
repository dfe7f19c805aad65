// SPDX-License-Identifier: BSD-3-Clause
#include "point_cloud2.hpp"

#include <algorithm>
#include <cstdint>
#include <limits>

#include <loopwise/core/error.hpp>

#include "cloud_points.hpp"

namespace loopwise::ros1 {
namespace {

struct Cloud {
  points::Layout layout;
  std::size_t width = 0;   // points a row
  std::size_t height = 0;  // rows
  std::size_t row_step = 0;
  bool big_endian = false;
  std::string_view data;
};

points::Scalar scalar_of(std::uint64_t datatype, const std::string& name) {
  // The constants INT8 = 1 to FLOAT64 = 8 of sensor_msgs/PointField.
  constexpr points::Scalar kScalars[] = {
      points::Scalar::kInt8,  points::Scalar::kUint8,  points::Scalar::kInt16,   points::Scalar::kUint16,
      points::Scalar::kInt32, points::Scalar::kUint32, points::Scalar::kFloat32, points::Scalar::kFloat64};
  if (datatype < 1 || datatype > 8) {
    throw InputError(name + ": a field of datatype " + std::to_string(datatype) + ", expected 1 to 8");
  }
  return kScalars[datatype - 1];
}

Cloud parse(const std::string& name, const Value& message) {
  Cloud cloud;
  cloud.width = message.at("width").unsigned_integer();
  cloud.height = message.at("height").unsigned_integer();
  cloud.row_step = message.at("row_step").unsigned_integer();
  cloud.big_endian = message.at("is_bigendian").integer() != 0;
  cloud.layout.point_size = message.at("point_step").unsigned_integer();
  cloud.data = message.at("data").raw();

  message.at("fields").for_each([&](const Value& field) {
    points::Field out;
    out.name = field.at("name").text();
    out.offset = field.at("offset").unsigned_integer();
    out.scalar = scalar_of(field.at("datatype").unsigned_integer(), name);
    // Some drivers leave the count of single numbers at 0.
    out.count = std::max<std::uint64_t>(1, field.at("count").unsigned_integer());
    const std::size_t room = cloud.layout.point_size;
    if (out.offset > room || out.count > (room - out.offset) / points::size_of(out.scalar)) {
      throw InputError(name + ": field " + out.name + " at byte " + std::to_string(out.offset) +
                       " does not fit into points of " + std::to_string(room) + " bytes");
    }
    cloud.layout.fields.push_back(std::move(out));
  });
  for (const std::size_t size : {cloud.width, cloud.height, cloud.row_step, cloud.layout.point_size}) {
    if (size > std::numeric_limits<std::uint32_t>::max()) {
      throw InputError(name + ": a size of " + std::to_string(size) + " exceeds 32 bits");
    }
  }
  if (cloud.width == 0 || cloud.height == 0) {
    cloud.width = cloud.height = 0;
    return cloud;  // empty clouds often have no fields
  }
  cloud.layout.find_channels(name);

  // All factors are 32-bit numbers, so that no product overflows.
  const std::uint64_t row = std::uint64_t{cloud.width} * cloud.layout.point_size;
  if (cloud.height == 1) cloud.row_step = row;  // the step has no meaning, and some drivers leave it at 0
  if (cloud.row_step < row) {
    throw InputError(name + ": rows of " + std::to_string(cloud.width) + " points of " +
                     std::to_string(cloud.layout.point_size) + " bytes do not fit into a row_step of " +
                     std::to_string(cloud.row_step));
  }
  const std::uint64_t rows_before_last = (cloud.height - 1) * std::uint64_t{cloud.row_step};
  if (rows_before_last > cloud.data.size() || row > cloud.data.size() - rows_before_last) {
    throw InputError(name + ": " + std::to_string(cloud.height) + " rows of " + std::to_string(cloud.width) +
                     " points do not fit into " + std::to_string(cloud.data.size()) + " bytes of data");
  }
  return cloud;
}

}  // namespace

void check_point_cloud2(const std::string& name, const Value& message) {
  static_cast<void>(parse(name, message));
}

CloudFile read_point_cloud2(const std::string& name, const Value& message) {
  const Cloud cloud = parse(name, message);
  points::CloudBuilder builder(name, cloud.layout.has_normals(), cloud.layout.has_intensity());
  builder.reserve(cloud.width * cloud.height);
  const bool swap = cloud.big_endian != points::big_endian_host();
  for (std::size_t row = 0; row < cloud.height; ++row) {
    points::read_binary(cloud.layout, cloud.data.substr(row * cloud.row_step), cloud.width, true, swap,
                        builder);
  }
  return builder.finish();
}

}  // namespace loopwise::ros1
