// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Points in files and messages: fields of any number type at any position. Private to io.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <loopwise/io/cloud.hpp>

namespace loopwise::points {

enum class Scalar { kInt8, kInt16, kInt32, kInt64, kUint8, kUint16, kUint32, kUint64, kFloat32, kFloat64 };

[[nodiscard]] std::size_t size_of(Scalar scalar);
/// The number at `bytes`; `swap` if its byte order is not the machine's.
[[nodiscard]] double load(Scalar scalar, const char* bytes, bool swap);
[[nodiscard]] bool big_endian_host();

/// Values of a point, by the names that the formats use.
enum Channel { kX, kY, kZ, kNormalX, kNormalY, kNormalZ, kIntensity, kChannels };
[[nodiscard]] std::optional<Channel> channel_of(std::string_view name);

/// Receives points one by one. Leaves out and counts unusable ones. Points whose middle is far from zero are
/// stored relative to an origin.
class CloudBuilder {
 public:
  /// \param name of the file or message, for problems
  CloudBuilder(std::string name, bool has_normals, bool has_intensity)
      : name_(std::move(name)), has_normals_(has_normals), has_intensity_(has_intensity) {}

  void reserve(std::size_t count);
  /// \param channels one value for each channel of the cloud
  void add(const double* channels);
  void add_problem(const std::string& kind, const std::string& example) { problems_.add(kind, example); }
  /// \param stated_origin origin of the coordinates according to the file
  [[nodiscard]] CloudFile finish(const std::optional<Eigen::Vector3d>& stated_origin = std::nullopt);

 private:
  struct Met {
    std::size_t first;
    std::size_t count;
  };
  void count_problem(const char* kind, std::size_t number);
  void count_coarse(const Eigen::Vector3d& point, std::size_t number);
  void turn_normals();

  std::string name_;
  bool has_normals_;
  bool has_intensity_;
  std::size_t count_ = 0;
  std::vector<Eigen::Vector3d> points_;  // as in the file
  PointCloud cloud_;
  Problems problems_;
  std::vector<std::pair<const char*, Met>> counted_;
  Met coarse_{0, 0};
  double coarse_step_m_ = 0.0;  // of the first such point
};

/// A number in the data of a point, and its position.
struct Field {
  std::string name;
  Scalar scalar = Scalar::kFloat32;
  std::size_t count = 1;   // number of adjacent values
  std::size_t offset = 0;  // within the bytes of a point
};

/// The fields of a point, and the channels that they fill.
struct Layout {
  std::vector<Field> fields;
  std::size_t point_size = 0;   // bytes
  std::size_t point_words = 0;  // values
  int field_of[kChannels] = {-1, -1, -1, -1, -1, -1, -1};

  [[nodiscard]] bool has_normals() const {
    return field_of[kNormalX] >= 0 && field_of[kNormalY] >= 0 && field_of[kNormalZ] >= 0;
  }
  [[nodiscard]] bool has_intensity() const { return field_of[kIntensity] >= 0; }

  /// Computes the offsets of consecutive fields, then finds the channels. \throws InputError as
  /// find_channels()
  void pack(const std::string& name);
  /// \throws InputError without x, y and z, or if a channel occurs twice
  void find_channels(const std::string& name);

  /// Fields by channel. Normals are left out unless all three components are present.
  [[nodiscard]] std::vector<std::pair<Channel, const Field*>> used() const;
};

/// Reads `count` points. They are either interleaved, with point_size bytes each, or stored field by field.
void read_binary(const Layout& layout, std::string_view data, std::size_t count, bool interleaved, bool swap,
                 CloudBuilder& builder);

/// As read_cloud() for a file in memory. The extension of its name states the format.
[[nodiscard]] CloudFile parse_cloud(const std::string& name, const std::string& contents,
                                    BinLayout bin_layout = BinLayout::kAuto);

/// Reads points without a header. \throws InputError if they do not fit the layout, or with kAuto do not look
/// like xyzi
[[nodiscard]] CloudFile read_bin(const std::string& name, std::string_view contents, BinLayout bin_layout);

/// The contents of a file of write_pcd().
[[nodiscard]] std::string pcd_text(const PointCloud& cloud, PcdEncoding encoding);

}  // namespace loopwise::points
