// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Binary files of arrays: CBOR (RFC 8949) whose byte strings are arrays of numbers, little-endian. Reading
/// checks sizes and numbers, and names the file and the field in errors.
#pragma once

#include <cmath>
#include <cstring>
#include <filesystem>
#include <string>
#include <type_traits>
#include <vector>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

namespace loopwise::training {

template <class T>
[[nodiscard]] nlohmann::json pack(const std::vector<T>& values) {
  std::vector<std::uint8_t> bytes(values.size() * sizeof(T));
  if (!bytes.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return nlohmann::json::binary(std::move(bytes));
}
/// Column by column.
template <class Derived>
[[nodiscard]] nlohmann::json pack(const Eigen::PlainObjectBase<Derived>& matrix) {
  using T = typename Derived::Scalar;
  return pack(std::vector<T>(matrix.data(), matrix.data() + matrix.size()));
}

/// A value within a file, and the way to it.
class Field {
 public:
  Field(std::string path, const nlohmann::json& value) : path_(std::move(path)), value_(&value) {}

  [[nodiscard]] Field operator[](const std::string& name) const {
    if (!value_->is_object() || !value_->contains(name))
      throw InputError(path_ + ": " + name + " is missing");
    return {path_ + ": " + name, value_->at(name)};
  }
  [[nodiscard]] std::vector<Field> items() const {
    if (!value_->is_array()) fail("expected a list");
    std::vector<Field> out;
    for (std::size_t i = 0; i < value_->size(); ++i) {
      out.emplace_back(path_ + "[" + std::to_string(i) + "]", value_->at(i));
    }
    return out;
  }
  [[nodiscard]] std::string text() const {
    if (!value_->is_string()) fail("expected text");
    return value_->get<std::string>();
  }
  [[nodiscard]] bool flag() const {
    if (!value_->is_boolean()) fail("expected true or false");
    return value_->get<bool>();
  }
  [[nodiscard]] double number() const {
    if (!value_->is_number() || !std::isfinite(value_->get<double>())) fail("expected a finite number");
    return value_->get<double>();
  }
  [[nodiscard]] std::uint64_t integer() const {
    if (!value_->is_number_unsigned()) fail("expected an integer, not negative");
    return value_->get<std::uint64_t>();
  }
  template <class T>
  [[nodiscard]] std::vector<T> values() const {
    if (!value_->is_binary()) fail("expected numbers");
    const std::vector<std::uint8_t>& bytes = value_->get_binary();
    if (bytes.size() % sizeof(T) != 0) fail("cut short");
    std::vector<T> out(bytes.size() / sizeof(T));
    if (!out.empty()) std::memcpy(out.data(), bytes.data(), bytes.size());
    if constexpr (std::is_floating_point_v<T>) {
      for (const T value : out) {
        if (!std::isfinite(value)) fail("a value is not finite");
      }
    }
    return out;
  }
  template <class T>
  [[nodiscard]] std::vector<T> values(std::size_t count) const {
    std::vector<T> out = values<T>();
    if (out.size() != count) {
      fail(std::to_string(out.size()) + " values, expected " + std::to_string(count));
    }
    return out;
  }
  template <class T>
  [[nodiscard]] Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic> matrix(Eigen::Index rows,
                                                                        Eigen::Index columns) const {
    const std::vector<T> all = values<T>();
    // No product of sizes before they are known to be small: it might overflow.
    const auto count = static_cast<Eigen::Index>(all.size());
    const bool none = rows == 0 || columns == 0;
    if (rows < 0 || columns < 0 || (none ? count != 0 : count / rows != columns || count % rows != 0)) {
      fail(std::to_string(all.size()) + " values, expected " + std::to_string(rows) + "x" +
           std::to_string(columns));
    }
    return Eigen::Map<const Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic>>(all.data(), rows, columns);
  }
  [[noreturn]] void fail(const std::string& why) const { throw InputError(path_ + ": " + why); }

 private:
  std::string path_;
  const nlohmann::json* value_;
};

inline void write_packed(const std::filesystem::path& path, const nlohmann::json& value) {
  std::string bytes;
  nlohmann::json::to_cbor(value, bytes);
  write_file(path, bytes);
}

/// Follows a file without keeping anything, and ends it where it is nested too deep.
class Depth final : public nlohmann::json_sax<nlohmann::json> {
 public:
  bool null() override { return true; }
  bool boolean(bool) override { return true; }
  bool number_integer(number_integer_t) override { return true; }
  bool number_unsigned(number_unsigned_t) override { return true; }
  bool number_float(number_float_t, const string_t&) override { return true; }
  bool string(string_t&) override { return true; }
  bool binary(binary_t&) override { return true; }
  bool start_object(std::size_t) override { return ++depth_ <= kDeepest; }
  bool key(string_t&) override { return true; }
  bool end_object() override { return depth_-- > 0; }
  bool start_array(std::size_t) override { return ++depth_ <= kDeepest; }
  bool end_array() override { return depth_-- > 0; }
  bool parse_error(std::size_t, const std::string&, const nlohmann::json::exception&) override {
    return false;
  }

 private:
  static constexpr int kDeepest = 64;
  int depth_ = 0;
};

/// \throws IoError; InputError if the file is cut short, of another format or version
[[nodiscard]] inline nlohmann::json read_packed(const std::filesystem::path& path, const std::string& format,
                                                int version) {
  const std::string bytes = read_file(path);
  nlohmann::json value;
  try {
    Depth depth;  // the parser calls itself for what is nested
    if (nlohmann::json::sax_parse(bytes, &depth, nlohmann::json::input_format_t::cbor)) {
      value = nlohmann::json::from_cbor(bytes);
    }
  } catch (const nlohmann::json::exception&) {
    value = nullptr;
  }
  if (value.is_null()) {
    throw InputError(path.string() + ": cut short or damaged, expected a file of format " + format);
  }
  const auto found = [&](const char* name) { return value.contains(name) ? value[name] : nlohmann::json(); };
  if (!value.is_object() || found("format") != format) {
    throw InputError(path.string() + ": expected a file of format " + format);
  }
  if (found("version") != version) {
    throw InputError(path.string() + ": version " + found("version").dump() + ", expected " +
                     std::to_string(version) + "; make it again");
  }
  return value;
}

}  // namespace loopwise::training
