// SPDX-License-Identifier: BSD-3-Clause
#include "ros_message.hpp"

#include <algorithm>
#include <array>
#include <cstring>

#include <loopwise/core/error.hpp>

#include "cloud_points.hpp"
#include "text.hpp"

namespace loopwise::ros1 {
namespace {

/// No message is larger, because no chunk of a bag is. Larger sizes are invalid, and sums of them could
/// overflow.
constexpr std::uint64_t kLargest = std::uint64_t{1} << 40;
/// Largest depth of types within types. Types of ROS are less than ten deep.
constexpr int kDeepestType = 100;

struct Name {
  std::string_view name;
  Primitive primitive;
  std::uint64_t size;  // 0: a string, whose length comes first
};
constexpr std::array<Name, 16> kPrimitives = {{{"bool", Primitive::kBool, 1},
                                               {"int8", Primitive::kInt8, 1},
                                               {"byte", Primitive::kInt8, 1},
                                               {"uint8", Primitive::kUint8, 1},
                                               {"char", Primitive::kUint8, 1},
                                               {"int16", Primitive::kInt16, 2},
                                               {"uint16", Primitive::kUint16, 2},
                                               {"int32", Primitive::kInt32, 4},
                                               {"uint32", Primitive::kUint32, 4},
                                               {"int64", Primitive::kInt64, 8},
                                               {"uint64", Primitive::kUint64, 8},
                                               {"float32", Primitive::kFloat32, 4},
                                               {"float64", Primitive::kFloat64, 8},
                                               {"string", Primitive::kString, 0},
                                               {"time", Primitive::kTime, 8},
                                               {"duration", Primitive::kDuration, 8}}};

/// ROS messages are little-endian.
template <class T>
T load_number(const char* bytes) {
  char buffer[sizeof(T)];
  std::memcpy(buffer, bytes, sizeof(T));
  if (points::big_endian_host()) std::reverse(buffer, buffer + sizeof(T));
  T value;
  std::memcpy(&value, buffer, sizeof(T));
  return value;
}

std::string package_of(const std::string& type) {
  return type.substr(0, type.find('/') == std::string::npos ? 0 : type.find('/') + 1);
}

bool is_separator(std::string_view line) {
  return line.size() >= 3 && line.find_first_not_of('=') == std::string_view::npos;
}

}  // namespace

Schema::Schema(const std::string& type, const std::string& definition) {
  for (const Name& name : kPrimitives) {
    Type primitive;
    primitive.name = name.name;
    primitive.primitive = name.primitive;
    if (name.size > 0) primitive.size = name.size;
    primitive.least = name.size > 0 ? name.size : 4;
    primitive.measured = Type::Measured::kYes;
    types_.push_back(std::move(primitive));
  }
  Type own;
  own.name = type;
  types_.insert(types_.begin(), own);

  std::size_t current = 0;
  bool expect_name = false;
  text::Lines lines(definition);
  for (std::string_view line; lines.next(line);) {
    if (is_separator(text::trim(line))) {
      expect_name = true;
      continue;
    }
    const std::string_view whole = text::trim(line.substr(0, line.find('#')));
    std::string_view rest = whole;
    const std::string_view word = text::next_word(rest);
    if (word.empty()) continue;
    if (expect_name) {
      const std::string_view name = text::next_word(rest);
      if (word != "MSG:" || name.empty()) fail("expected \"MSG: package/Type\"", lines.number());
      Type next;
      next.name = std::string(name);
      types_.push_back(std::move(next));
      current = types_.size() - 1;
      expect_name = false;
      continue;
    }
    Field field;
    field.line = lines.number();
    std::string_view type_name = word;
    if (const std::size_t bracket = word.find('['); bracket != std::string_view::npos) {
      field.array = true;
      type_name = word.substr(0, bracket);
      std::string_view count = word.substr(bracket + 1);
      if (count.empty() || count.back() != ']') fail(text::quoted(word) + " is not a type", lines.number());
      count.remove_suffix(1);
      std::uint64_t number = 0;
      if (!count.empty() && text::parse_id(count, number) != nullptr) {
        fail(text::quoted(word) + " is not a type", lines.number());
      }
      if (!count.empty()) field.count = number;
    }
    field.type_name = std::string(type_name);
    if (rest.find('=') != std::string_view::npos) continue;  // a constant: "int32 ODOM = 0"
    const std::string_view name = text::next_word(rest);
    if (name.empty() || !text::next_word(rest).empty()) {
      fail(text::quoted(whole) + " is not a field", lines.number());
    }
    field.name = std::string(name);
    types_[current].fields.push_back(std::move(field));
  }

  std::unordered_map<std::string, std::size_t> names;
  for (std::size_t i = 0; i < types_.size(); ++i) names.emplace(types_[i].name, i);  // the first of a name
  for (Type& used : types_) {
    for (Field& field : used.fields) field.type = find(names, field.type_name, used, field.line);
  }
  measure(0, 0);
}

void Schema::fail(const std::string& why, std::size_t line) const {
  throw InputError("definition of " + type() + (line > 0 ? ":" + std::to_string(line) : std::string()) +
                   ": " + why);
}

std::size_t Schema::find(const std::unordered_map<std::string, std::size_t>& names, const std::string& name,
                         const Type& used_in, std::size_t line) const {
  const auto by_name = [&](const std::string& wanted) {
    const auto found = names.find(wanted);
    return found == names.end() ? types_.size() : found->second;
  };
  for (const std::string& full : {name, package_of(used_in.name) + name, package_of(type()) + name}) {
    if (const std::size_t found = by_name(full); found < types_.size()) return found;
  }
  if (name == "Header") {
    if (const std::size_t found = by_name("std_msgs/Header"); found < types_.size()) return found;
  }
  fail("type " + text::quoted(name) + " is not defined", line);
}

void Schema::measure(std::size_t number, int depth) {
  if (types_[number].measured == Type::Measured::kYes) return;
  if (types_[number].measured == Type::Measured::kNow)
    fail("type " + types_[number].name + " contains itself");
  if (depth > kDeepestType) fail("types are nested more than " + std::to_string(kDeepestType) + " deep");
  types_[number].measured = Type::Measured::kNow;
  std::uint64_t least = 0;
  bool fixed = true;
  for (const Field& field : types_[number].fields) {
    measure(field.type, depth + 1);
    const Type& type = types_[field.type];
    std::uint64_t bytes = type.least;
    if (field.array) {
      const std::uint64_t count = field.count.value_or(0);
      if (count > kLargest || type.least > kLargest / std::max<std::uint64_t>(count, 1)) {
        fail("field " + field.name + " is too large", field.line);
      }
      bytes = field.count ? count * type.least : 4;
    }
    least += bytes;
    if (least > kLargest) fail("type " + types_[number].name + " is too large");
    // An array of zero elements has a fixed size, too. So every type without bytes has a fixed size, and its
    // elements are never visited one by one.
    fixed = fixed && (!field.array ? type.size.has_value() : field.count && (type.size || *field.count == 0));
  }
  types_[number].least = least;
  if (fixed) types_[number].size = least;
  types_[number].measured = Type::Measured::kYes;
}

Value::Value(const Schema& schema, std::string_view bytes) : Value(schema, 0, bytes) {
  const std::size_t used = length();
  if (used != bytes.size()) {
    fail("the message has " + std::to_string(bytes.size()) + " bytes, its definition needs " +
         std::to_string(used));
  }
}

void Value::fail(const std::string& why) const {
  throw InputError(schema_->type() + ": " + why);
}

std::size_t Value::length_of(std::size_t number, std::string_view bytes) const {
  const Schema::Type& type = schema_->types_[number];
  if (bytes.size() < type.least) {
    fail(type.name + " needs " + std::to_string(type.least) + " bytes, " + std::to_string(bytes.size()) +
         " are left: the message is cut short");
  }
  if (type.size) return static_cast<std::size_t>(*type.size);
  if (type.primitive == Primitive::kString) {
    const std::size_t size = load_number<std::uint32_t>(bytes.data());
    if (size > bytes.size() - 4) {
      fail("a string of " + std::to_string(size) + " bytes, " + std::to_string(bytes.size() - 4) +
           " are left");
    }
    return 4 + size;
  }
  std::size_t used = 0;
  for (const Schema::Field& field : type.fields) used += length_of(field, bytes.substr(used));
  return used;
}

std::size_t Value::length_of(const Schema::Field& field, std::string_view bytes) const {
  if (!field.array) return length_of(field.type, bytes);
  std::size_t used = 0;
  std::uint64_t count = 0;
  if (field.count) {
    count = *field.count;
  } else {
    if (bytes.size() < 4) fail("field " + field.name + ": the message is cut short");
    count = load_number<std::uint32_t>(bytes.data());
    used = 4;
  }
  const Schema::Type& type = schema_->types_[field.type];
  if (type.least > 0 && count > (bytes.size() - used) / type.least) {
    fail("field " + field.name + ": " + std::to_string(count) + " elements of at least " +
         std::to_string(type.least) + " bytes, " + std::to_string(bytes.size() - used) + " bytes are left");
  }
  if (type.size || count == 0) return used + static_cast<std::size_t>(count * type.size.value_or(0));
  for (std::uint64_t i = 0; i < count; ++i) used += length_of(field.type, bytes.substr(used));
  return used;
}

std::size_t Value::length() const {
  return array_ ? length_of(*array_, bytes_) : length_of(type_, bytes_);
}

bool Value::has(std::string_view field) const {
  const auto& fields = type().fields;
  return !array_ && std::any_of(fields.begin(), fields.end(), [&](const auto& f) { return f.name == field; });
}

Value Value::at(std::string_view name) const {
  if (array_) fail("an array has no field " + std::string(name));
  std::size_t used = 0;
  for (const Schema::Field& field : type().fields) {
    if (field.name == name) {
      Value value(*schema_, field.type, bytes_.substr(used));
      if (field.array) value.array_ = &field;
      return value;
    }
    used += length_of(field, bytes_.substr(used));
  }
  fail("no field " + std::string(name) + " in " + type().name);
}

std::uint64_t Value::unsigned_integer() const {
  if (!array_ && type().primitive == Primitive::kUint64) {
    static_cast<void>(length());
    return load_number<std::uint64_t>(bytes_.data());
  }
  const std::int64_t value = integer();
  if (value < 0) fail("a number is negative");
  return static_cast<std::uint64_t>(value);
}

std::int64_t Value::integer() const {
  static_cast<void>(length());
  const char* const at = bytes_.data();
  if (!array_) {
    switch (type().primitive) {
      case Primitive::kBool:
      case Primitive::kUint8:
        return load_number<std::uint8_t>(at);
      case Primitive::kInt8:
        return load_number<std::int8_t>(at);
      case Primitive::kInt16:
        return load_number<std::int16_t>(at);
      case Primitive::kUint16:
        return load_number<std::uint16_t>(at);
      case Primitive::kInt32:
        return load_number<std::int32_t>(at);
      case Primitive::kUint32:
        return load_number<std::uint32_t>(at);
      case Primitive::kInt64:
        return load_number<std::int64_t>(at);
      case Primitive::kUint64: {
        const std::uint64_t value = load_number<std::uint64_t>(at);
        if (value >> 63 != 0) fail("a number exceeds 63 bits");
        return static_cast<std::int64_t>(value);
      }
      default:
        break;
    }
  }
  fail(type().name + " is not a whole number");
}

double Value::number() const {
  static_cast<void>(length());
  if (!array_ && type().primitive == Primitive::kFloat64) return load_number<double>(bytes_.data());
  if (!array_ && type().primitive == Primitive::kFloat32)
    return static_cast<double>(load_number<float>(bytes_.data()));
  return static_cast<double>(integer());
}

std::string_view Value::text() const {
  if (array_ || type().primitive != Primitive::kString) fail(type().name + " is not a string");
  return bytes_.substr(4, length() - 4);
}

std::int64_t Value::time_ns() const {
  if (array_ || type().primitive != Primitive::kTime) fail(type().name + " is not a time");
  static_cast<void>(length());
  return static_cast<std::int64_t>(load_number<std::uint32_t>(bytes_.data())) * 1'000'000'000 +
         static_cast<std::int64_t>(load_number<std::uint32_t>(bytes_.data() + 4));
}

std::size_t Value::size() const {
  if (!array_) fail(type().name + " is not an array");
  if (array_->count) return static_cast<std::size_t>(*array_->count);
  if (bytes_.size() < 4) fail("field " + array_->name + ": the message is cut short");
  return load_number<std::uint32_t>(bytes_.data());
}

Value Value::first() const {
  static_cast<void>(size());  // throws unless it is an array
  return {*schema_, type_, bytes_.substr(array_->count ? 0 : 4)};
}

std::string_view Value::raw() const {
  const std::size_t whole = length();
  if (!array_ || !type().size) fail("no array of numbers");
  const std::size_t head = array_->count ? 0 : 4;
  return bytes_.substr(head, whole - head);
}

std::vector<double> Value::numbers() const {
  std::vector<double> out;
  static_cast<void>(length());
  out.reserve(std::min(size(), bytes_.size()));
  for_each([&](const Value& element) { out.push_back(element.number()); });
  return out;
}

}  // namespace loopwise::ros1
