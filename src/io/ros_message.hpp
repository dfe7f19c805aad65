// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// ROS 1 messages, read by the text that defines them. A bag has this text for every topic, so no position of
/// a field is assumed. Private to io.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

namespace loopwise::ros1 {

enum class Primitive {
  kBool,
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64,
  kString,
  kTime,
  kDuration,
  kMessage,  ///< Not primitive, but made of fields.
};

/// All types that occur in a message.
class Schema {
 public:
  /// Parses a message definition: fields and constants (which are skipped), then the same for each used type
  /// after a line of '=' and "MSG: package/Type". \throws InputError naming the type and the line for an
  /// invalid text, a missing type, or a type that contains itself
  Schema(const std::string& type, const std::string& definition);

  [[nodiscard]] const std::string& type() const { return types_.front().name; }

 private:
  friend class CdrReader;  // of ROS 2, see cdr.hpp
  friend class Value;
  struct Field {
    std::string name;
    std::size_t type = 0;  // in types_
    bool array = false;
    std::optional<std::uint64_t> count;  // of an array of fixed length
    std::string type_name;               // until it is resolved
    std::size_t line = 0;
  };
  struct Type {
    std::string name;
    Primitive primitive = Primitive::kMessage;
    std::vector<Field> fields;
    std::optional<std::uint64_t> size;  // bytes, if constant
    std::uint64_t least = 0;            // bytes
    enum class Measured { kNo, kNow, kYes } measured = Measured::kNo;
  };

  [[nodiscard]] std::size_t find(const std::unordered_map<std::string, std::size_t>& names,
                                 const std::string& name, const Type& used_in, std::size_t line) const;
  void measure(std::size_t type, int depth);
  [[noreturn]] void fail(const std::string& why, std::size_t line = 0) const;

  std::vector<Type> types_;  // the message's own first
};

/// A message, a field or an array, as a position in the bytes of a message. It refers to the schema and the
/// bytes, which must outlive it. Each access is checked against the end of the bytes.
class Value {
 public:
  /// The whole message. \throws InputError if the bytes are not exactly one message of the type.
  Value(const Schema& schema, std::string_view bytes);

  [[nodiscard]] bool has(std::string_view field) const;
  /// A field of a message. \throws InputError if there is no field of this name
  [[nodiscard]] Value at(std::string_view field) const;

  /// \throws InputError unless it is a number (or bool)
  [[nodiscard]] double number() const;
  /// \throws InputError unless it is a whole number (or bool)
  [[nodiscard]] std::int64_t integer() const;
  [[nodiscard]] std::uint64_t unsigned_integer() const;
  /// \throws InputError unless it is a string
  [[nodiscard]] std::string_view text() const;
  /// \throws InputError unless it is a time
  [[nodiscard]] std::int64_t time_ns() const;

  /// Number of elements of an array. \throws InputError unless it is an array; also in the functions below
  [[nodiscard]] std::size_t size() const;
  template <class Call>
  void for_each(Call&& call) const {
    Value element = first();
    for (std::size_t i = 0, n = size(); i < n; ++i) {
      call(element);
      if (i + 1 < n) element.bytes_.remove_prefix(element.length());
    }
  }
  /// The bytes of an array whose elements have a fixed size.
  [[nodiscard]] std::string_view raw() const;
  [[nodiscard]] std::vector<double> numbers() const;

 private:
  Value(const Schema& schema, std::size_t type, std::string_view bytes)
      : schema_(&schema), type_(type), bytes_(bytes) {}
  [[nodiscard]] const Schema::Type& type() const { return schema_->types_[type_]; }
  [[nodiscard]] Value first() const;
  [[nodiscard]] std::size_t length() const;
  [[nodiscard]] std::size_t length_of(std::size_t type, std::string_view bytes) const;
  [[nodiscard]] std::size_t length_of(const Schema::Field& field, std::string_view bytes) const;
  [[noreturn]] void fail(const std::string& why) const;

  const Schema* schema_;
  std::size_t type_ = 0;
  const Schema::Field* array_ = nullptr;  // the field, if it is an array
  std::string_view bytes_;                // from its first byte to the message's last
};

}  // namespace loopwise::ros1
