// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Binary files of arrays: CBOR (RFC 8949) whose byte strings are arrays of numbers, little-endian. Reading
/// checks sizes and numbers, and names the file and the field in errors.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>
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
  // Not json::binary(), which destroys an uninitialised value if an allocation fails.
  nlohmann::json out(nlohmann::json::value_t::binary);
  out.get_binary() = nlohmann::json::binary_t(std::move(bytes));
  return out;
}
/// Packs a matrix column by column.
template <class Derived>
[[nodiscard]] nlohmann::json pack(const Eigen::PlainObjectBase<Derived>& matrix) {
  using T = typename Derived::Scalar;
  return pack(std::vector<T>(matrix.data(), matrix.data() + matrix.size()));
}

/// A value in a file, with its path for messages.
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
    // Sizes are compared without their product, which might overflow.
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

/// Whether the bytes are safe for the parser, which recurses into nested values. They must be one value with
/// little nesting and with all lengths stated, as write_packed() writes them. Texts in chunks are refused
/// because they could be nested too.
[[nodiscard]] inline bool is_shallow_cbor(std::string_view bytes) {
  constexpr std::size_t kDeepest = 64;
  std::vector<std::uint64_t> open;  // missing values of each open list, the outermost list first
  do {
    if (bytes.empty()) return false;
    const auto head = static_cast<unsigned char>(bytes.front());
    bytes.remove_prefix(1);
    const unsigned kind = head >> 5U, detail = head & 31U;
    std::uint64_t length = detail;
    if (detail >= 24) {
      const std::size_t size = detail <= 27 ? std::size_t{1} << (detail - 24) : bytes.size() + 1;
      if (size > bytes.size()) return false;
      length = 0;
      for (const char byte : bytes.substr(0, size)) length = length << 8U | static_cast<unsigned char>(byte);
      bytes.remove_prefix(size);
    }
    if (!open.empty()) --open.back();
    if (kind >= 2 && kind <= 5 && length > bytes.size()) return false;
    if (kind == 2 || kind == 3) bytes.remove_prefix(static_cast<std::size_t>(length));
    if (kind == 4) open.push_back(length);
    if (kind == 5) open.push_back(2 * length);  // names and values
    if (kind == 6 || open.size() > kDeepest) return false;
    while (!open.empty() && open.back() == 0) open.pop_back();
  } while (!open.empty());
  return bytes.empty();
}

/// \throws IoError; InputError if the file is cut short or has another format or version
[[nodiscard]] inline nlohmann::json read_packed(const std::filesystem::path& path, const std::string& format,
                                                int version) {
  const std::string bytes = read_file(path);
  nlohmann::json value;
  try {
    if (is_shallow_cbor(bytes)) value = nlohmann::json::from_cbor(bytes);
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
    using Handler = nlohmann::json::error_handler_t;  // for texts that are not UTF-8
    throw InputError(path.string() + ": version " + found("version").dump(-1, ' ', false, Handler::replace) +
                     ", expected " + std::to_string(version) + "; make it again");
  }
  return value;
}

}  // namespace loopwise::training
