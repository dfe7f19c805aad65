// SPDX-License-Identifier: BSD-3-Clause
#include "cloud_points.hpp"

#include <algorithm>
#include <sstream>

#include <loopwise/core/error.hpp>
#include <loopwise/core/robust_centre.hpp>

namespace loopwise::points {
namespace {

/// Only maps of the whole earth have larger coordinates.
constexpr double kMaxCoordinate_m = 1e7;
constexpr float kNormalTolerance = 0.01f;
/// From this value on, neighbouring floats are at least 2 mm apart.
constexpr double kCoarse_m = 16384.0;
/// The middle of a lidar scan is never this far from the sensor, so such points are in other coordinates.
constexpr double kFarFromSensor_m = 300.0;

template <class T>
double load_as(const char* bytes, bool swap) {
  char buffer[sizeof(T)];
  std::memcpy(buffer, bytes, sizeof(T));
  if (swap) std::reverse(buffer, buffer + sizeof(T));
  T value;
  std::memcpy(&value, buffer, sizeof(T));
  return static_cast<double>(value);
}

}  // namespace

std::size_t size_of(Scalar scalar) {
  switch (scalar) {
    case Scalar::kInt8:
    case Scalar::kUint8:
      return 1;
    case Scalar::kInt16:
    case Scalar::kUint16:
      return 2;
    case Scalar::kInt32:
    case Scalar::kUint32:
    case Scalar::kFloat32:
      return 4;
    default:
      return 8;
  }
}

double load(Scalar scalar, const char* bytes, bool swap) {
  switch (scalar) {
    case Scalar::kInt8:
      return load_as<std::int8_t>(bytes, swap);
    case Scalar::kInt16:
      return load_as<std::int16_t>(bytes, swap);
    case Scalar::kInt32:
      return load_as<std::int32_t>(bytes, swap);
    case Scalar::kInt64:
      return load_as<std::int64_t>(bytes, swap);
    case Scalar::kUint8:
      return load_as<std::uint8_t>(bytes, swap);
    case Scalar::kUint16:
      return load_as<std::uint16_t>(bytes, swap);
    case Scalar::kUint32:
      return load_as<std::uint32_t>(bytes, swap);
    case Scalar::kUint64:
      return load_as<std::uint64_t>(bytes, swap);
    case Scalar::kFloat32:
      return load_as<float>(bytes, swap);
    case Scalar::kFloat64:
      return load_as<double>(bytes, swap);
  }
  return 0.0;
}

bool big_endian_host() {
  const std::uint16_t one = 1;
  char first;
  std::memcpy(&first, &one, 1);
  return first == 0;
}

std::optional<Channel> channel_of(std::string_view name) {
  constexpr std::string_view kNames[][3] = {{"x", "", ""},
                                            {"y", "", ""},
                                            {"z", "", ""},
                                            {"normal_x", "nx", ""},
                                            {"normal_y", "ny", ""},
                                            {"normal_z", "nz", ""},
                                            {"intensity", "scalar_intensity", "scalar_Intensity"}};
  for (int channel = 0; channel < kChannels; ++channel) {
    for (const std::string_view known : kNames[channel]) {
      if (!known.empty() && known == name) return static_cast<Channel>(channel);
    }
  }
  return std::nullopt;
}

void CloudBuilder::reserve(std::size_t count) {
  points_.reserve(count);
  if (has_normals_) cloud_.normals.reserve(count);
  if (has_intensity_) cloud_.intensities.reserve(count);
}

void CloudBuilder::add(const double* channels) {
  const Eigen::Vector3d point(channels[kX], channels[kY], channels[kZ]);
  const std::size_t number = count_++;
  if (!point.allFinite()) {
    count_problem("point not finite", number);
    return;
  }
  if (point.cwiseAbs().maxCoeff() > kMaxCoordinate_m) {
    count_problem("point out of range", number);
    return;
  }
  points_.push_back(point);
  count_coarse(point, number);
  if (has_normals_) {
    Eigen::Vector3f normal(static_cast<float>(channels[kNormalX]), static_cast<float>(channels[kNormalY]),
                           static_cast<float>(channels[kNormalZ]));
    const float length = normal.norm();
    if (std::abs(length - 1.0f) <= kNormalTolerance) {
      normal /= length;
    } else {
      count_problem("unusable normals", number);
    }
    cloud_.normals.push_back(normal);
  }
  if (has_intensity_) {
    const auto intensity = static_cast<float>(channels[kIntensity]);
    const bool finite = std::isfinite(intensity);
    if (!finite) count_problem("intensity not finite", number);
    cloud_.intensities.push_back(finite ? intensity : 0.0f);
  }
}

/// Floats are coarse at this distance. A coordinate that equals a float exactly was once stored as a float.
void CloudBuilder::count_coarse(const Eigen::Vector3d& point, std::size_t number) {
  const double largest = point.cwiseAbs().maxCoeff();
  if (largest < kCoarse_m || point.cast<float>().cast<double>() != point) return;
  if (coarse_.count++ == 0) {
    coarse_.first = number;
    coarse_step_m_ = std::ldexp(1.0, std::ilogb(largest) - 23);  // 24 bits
  }
}

/// Turns normals towards the sensor, which is at the origin of the coordinates.
void CloudBuilder::turn_normals() {
  for (std::size_t i = 0; i < cloud_.normals.size(); ++i) {
    Eigen::Vector3f& normal = cloud_.normals[i];
    if (cloud_.points[i].dot(normal) > 0.0f) normal = -normal;
  }
}

CloudFile CloudBuilder::finish(const std::optional<Eigen::Vector3d>& stated_origin) {
  for (const auto& [kind, met] : counted_) {
    problems_.add(kind, name_ + ": point " + std::to_string(met.first), met.count);
    if (std::string_view(kind) == "unusable normals") cloud_.normals.clear();
  }
  // A few far points among near ones are outliers, which later stages remove.
  if (2 * coarse_.count > points_.size()) {
    std::ostringstream example;
    example << name_ << ": point " << coarse_.first << ", in steps of " << coarse_step_m_ << " m";
    problems_.add("point rounded to a float far from zero", example.str(), coarse_.count);
  }
  const Eigen::Vector3d centre = robust_centre(points_);
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();
  if (centre.norm() > kFarFromSensor_m) shift = centre.array().round();
  cloud_.points.reserve(points_.size());
  for (const Eigen::Vector3d& point : points_) cloud_.points.push_back((point - shift).cast<float>());
  cloud_.origin = stated_origin.value_or(Eigen::Vector3d::Zero()) + shift;
  turn_normals();
  cloud_.normals.shrink_to_fit();
  return {std::move(cloud_), std::move(problems_)};
}

void CloudBuilder::count_problem(const char* kind, std::size_t number) {
  for (auto& [known, met] : counted_) {
    if (std::string_view(known) == kind) {
      ++met.count;
      return;
    }
  }
  counted_.push_back({kind, {number, 1}});
}

void Layout::pack(const std::string& name) {
  for (Field& field : fields) {
    field.offset = point_size;
    point_size += size_of(field.scalar) * field.count;
    point_words += field.count;
  }
  find_channels(name);
}

void Layout::find_channels(const std::string& name) {
  for (std::size_t i = 0; i < fields.size(); ++i) {
    const auto channel = channel_of(fields[i].name);
    if (!channel || fields[i].count != 1) continue;
    if (field_of[*channel] >= 0) throw InputError(name + ": field " + fields[i].name + " is listed twice");
    field_of[*channel] = static_cast<int>(i);
  }
  for (const Channel channel : {kX, kY, kZ}) {
    if (field_of[channel] < 0) throw InputError(name + ": the points have no x, y and z");
  }
}

std::vector<std::pair<Channel, const Field*>> Layout::used() const {
  std::vector<std::pair<Channel, const Field*>> out;
  for (int c = 0; c < kChannels; ++c) {
    const bool normal = c >= kNormalX && c <= kNormalZ;
    if (field_of[c] >= 0 && (!normal || has_normals())) {
      out.emplace_back(static_cast<Channel>(c), &fields[static_cast<std::size_t>(field_of[c])]);
    }
  }
  return out;
}

void read_binary(const Layout& layout, std::string_view data, std::size_t count, bool interleaved, bool swap,
                 CloudBuilder& builder) {
  const auto used = layout.used();
  builder.reserve(count);
  double channels[kChannels] = {};
  for (std::size_t i = 0; i < count; ++i) {
    for (const auto& [channel, field] : used) {
      const std::size_t at = interleaved ? i * layout.point_size + field->offset
                                         : count * field->offset + i * size_of(field->scalar) * field->count;
      channels[channel] = load(field->scalar, data.data() + at, swap);
    }
    builder.add(channels);
  }
}

}  // namespace loopwise::points
