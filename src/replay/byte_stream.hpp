// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Numbers, poses and texts one after the other as bytes. Numbers have this machine's byte order.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include <Eigen/Geometry>

#include <loopwise/core/error.hpp>

namespace loopwise {

class ByteWriter {
 public:
  template <class T>
  ByteWriter& put(const T& value) {
    static_assert(std::is_arithmetic_v<T> || std::is_enum_v<T>);
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  ByteWriter& put(const std::string& text) {
    put(static_cast<std::uint32_t>(text.size()));
    bytes_ += text;
    return *this;
  }
  ByteWriter& put(const Eigen::Isometry3d& pose) {
    return matrix(Eigen::Matrix<double, 3, 4>(pose.matrix().topRows<3>()));
  }
  /// Writes a matrix row by row.
  template <class Matrix>
  ByteWriter& matrix(const Matrix& m) {
    for (Eigen::Index i = 0; i < m.rows(); ++i) {
      for (Eigen::Index j = 0; j < m.cols(); ++j) put<double>(m(i, j));
    }
    return *this;
  }
  [[nodiscard]] std::string take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

/// Reads the bytes of a ByteWriter. All functions \throws InputError if the bytes end too early.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  template <class T>
  [[nodiscard]] T get() {
    static_assert(std::is_trivially_copyable_v<T>);
    T value;
    std::memcpy(&value, take(sizeof value).data(), sizeof value);
    return value;
  }
  [[nodiscard]] bool flag() { return one_of(1) != 0; }
  /// A byte from 0 to `last`.
  [[nodiscard]] std::uint8_t one_of(std::uint8_t last) {
    const auto value = get<std::uint8_t>();
    if (value > last) throw InputError("a message has an undefined value");
    return value;
  }
  template <class Matrix>
  [[nodiscard]] Matrix matrix() {
    Matrix m;
    for (Eigen::Index i = 0; i < m.rows(); ++i) {
      for (Eigen::Index j = 0; j < m.cols(); ++j) m(i, j) = get<double>();
    }
    return m;
  }
  [[nodiscard]] Eigen::Isometry3d pose() {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.affine() = matrix<Eigen::Matrix<double, 3, 4>>();
    return pose;
  }
  [[nodiscard]] std::string text() { return std::string(take(get<std::uint32_t>())); }
  void end() const {
    if (!bytes_.empty()) throw InputError("a message is too long");
  }

 private:
  std::string_view take(std::size_t size) {
    if (bytes_.size() < size) throw InputError("a message was cut short");
    const std::string_view out = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return out;
  }
  std::string_view bytes_;
};

}  // namespace loopwise
