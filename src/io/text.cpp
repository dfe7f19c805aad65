// SPDX-License-Identifier: BSD-3-Clause
#include "text.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <Eigen/SVD>

#include <loopwise/core/error.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise::text {

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  return text;
}

std::string quoted(std::string_view text) {
  constexpr std::size_t kLongest = 40;
  std::string out = "\"";
  for (const char c : text.substr(0, kLongest)) out += c >= ' ' && c <= '~' ? c : '?';
  return out + (text.size() > kLongest ? "...\"" : "\"");
}

namespace {

/// Size in bytes of the first UTF-8 character of a text that is not empty; 0 if it is not UTF-8.
std::size_t character_size(std::string_view text) {
  const auto byte = [&](std::size_t i) { return i < text.size() ? static_cast<unsigned char>(text[i]) : 0u; };
  const auto within = [&](std::size_t i, unsigned least, unsigned most) {
    return byte(i) >= least && byte(i) <= most;
  };
  const auto follows = [&](std::size_t i) { return within(i, 0x80, 0xBF); };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  if (within(0, 0xC2, 0xDF)) return follows(1) ? 2 : 0;
  // Excludes overlong forms, surrogates, and values beyond the last character.
  if (within(0, 0xE0, 0xEF)) {
    return within(1, first == 0xE0 ? 0xA0 : 0x80, first == 0xED ? 0x9F : 0xBF) && follows(2) ? 3 : 0;
  }
  if (within(0, 0xF0, 0xF4)) {
    const bool second = within(1, first == 0xF0 ? 0x90 : 0x80, first == 0xF4 ? 0x8F : 0xBF);
    return second && follows(2) && follows(3) ? 4 : 0;
  }
  return 0;
}

}  // namespace

bool is_utf8(std::string_view text) {
  while (!text.empty()) {
    const std::size_t size = character_size(text);
    if (size == 0) return false;
    text.remove_prefix(size);
  }
  return true;
}

std::string legible(std::string_view text) {
  constexpr const char* kDigits = "0123456789ABCDEF";
  std::string out;
  while (!text.empty()) {
    const std::size_t size = character_size(text);
    if (size > 0) {
      out += text.substr(0, size);
    } else {
      const auto byte = static_cast<unsigned char>(text.front());
      out += {'%', kDigits[byte >> 4], kDigits[byte & 15]};
    }
    text.remove_prefix(std::max<std::size_t>(size, 1));
  }
  return out;
}

Lines::Lines(std::string_view all) : rest_(all) {
  if (rest_.substr(0, 3) == "\xef\xbb\xbf") rest_.remove_prefix(3);
}

bool Lines::next(std::string_view& line) {
  if (rest_.empty()) return false;
  const std::size_t end = rest_.find('\n');
  ended_ = end != std::string_view::npos;
  line = rest_.substr(0, end);
  rest_.remove_prefix(ended_ ? end + 1 : rest_.size());
  ++number_;
  return true;
}

namespace {

/// Whether a number out of a double's range is too small, judged by the power of ten of its first digit.
bool is_tiny(std::string_view word) {
  constexpr std::int64_t kFar = std::int64_t{1} << 40;
  const std::size_t mark = std::min(word.find_first_of("eE"), word.size());
  std::string_view mantissa = word.substr(0, mark);
  if (!mantissa.empty() && mantissa.front() == '-') mantissa.remove_prefix(1);
  const std::size_t point = std::min(mantissa.find('.'), mantissa.size());
  const std::size_t first = std::min(mantissa.find_first_not_of("0."), mantissa.size());
  std::int64_t power = static_cast<std::int64_t>(point) - static_cast<std::int64_t>(first);
  if (mark < word.size()) {
    std::string_view digits = word.substr(mark + 1);
    const bool negative = digits.front() == '-';
    if (negative || digits.front() == '+') digits.remove_prefix(1);
    std::int64_t exponent = 0;
    for (const char digit : digits) exponent = std::min(exponent * 10 + (digit - '0'), kFar);
    power += negative ? -exponent : exponent;
  }
  return power < 0;
}

}  // namespace

Number parse_double(std::string_view word, double& value) {
  if (word.size() > 1 && word[0] == '+' && word[1] != '-' && word[1] != '+') word.remove_prefix(1);
  const char* const last = word.data() + word.size();
  const auto [end, error] = std::from_chars(word.data(), last, value);
  if (end != last || error == std::errc::invalid_argument) return Number::kNotANumber;
  if (error == std::errc::result_out_of_range) {
    // from_chars does not state whether the number is too large or too small.
    if (!is_tiny(word)) return Number::kNotFinite;
    value = 0.0;
  }
  return std::isfinite(value) ? Number::kOk : Number::kNotFinite;
}

const char* parse_id(std::string_view word, std::uint64_t& value) {
  const char* const last = word.data() + word.size();
  if (word.size() > 1 && word[0] == '-' && std::isdigit(static_cast<unsigned char>(word[1])))
    return "is negative";
  const auto [end, error] = std::from_chars(word.data(), last, value);
  if (end != last || error == std::errc::invalid_argument) return "is not a whole number";
  if (error == std::errc::result_out_of_range) return "exceeds 64 bits";
  return nullptr;
}

bool parse_int64(std::string_view word, std::int64_t& value) {
  const char* const last = word.data() + word.size();
  const auto [end, error] = std::from_chars(word.data(), last, value);
  return end == last && error == std::errc();
}

std::optional<std::int64_t> parse_seconds_ns(std::string_view word) {
  double seconds = 0.0;
  if (parse_double(word, seconds) != Number::kOk || std::abs(seconds) > 9.2e9) return std::nullopt;
  const bool negative = word[0] == '-';
  std::string_view digits = word;
  if (negative || word[0] == '+') digits.remove_prefix(1);
  if (digits.find_first_not_of("0123456789.") != std::string_view::npos) {
    // Programs print stamps of 1e18 ns with an exponent. Shifting the decimal point is exact; a product is
    // not.
    const std::size_t mark = digits.find_first_of("eE");
    std::int64_t exponent = 0;
    std::string_view tail = digits.substr(mark + 1);
    if (!tail.empty() && tail[0] == '+') tail.remove_prefix(1);
    const auto parsed = std::from_chars(tail.data(), tail.data() + tail.size(), exponent);
    std::string plain(digits.substr(0, mark));
    // The number is finite and not large, so after such a shift it is zero to the nanosecond.
    const auto far = static_cast<std::int64_t>(400 + plain.size());
    if (parsed.ec != std::errc() || exponent > far || exponent < -far) return 0;
    std::size_t point = plain.find('.');
    if (point == std::string::npos) {
      point = plain.size();
    } else {
      plain.erase(point, 1);
    }
    const auto shifted = static_cast<std::ptrdiff_t>(point) + exponent;
    if (shifted <= 0) {
      plain.insert(0, static_cast<std::size_t>(1 - shifted), '0');
      plain.insert(1, 1, '.');
    } else {
      if (static_cast<std::size_t>(shifted) > plain.size())
        plain.append(static_cast<std::size_t>(shifted) - plain.size(), '0');
      plain.insert(static_cast<std::size_t>(shifted), 1, '.');
    }
    return parse_seconds_ns((negative ? "-" : "") + plain);
  }
  const std::size_t point = std::min(digits.find('.'), digits.size());
  std::int64_t ns = 0;
  for (std::size_t i = 0; i < point; ++i) ns = ns * 10 + (digits[i] - '0');
  for (std::size_t i = 1; i <= 9; ++i) {
    ns = ns * 10 + (point + i < digits.size() ? digits[point + i] - '0' : 0);
  }
  if (point + 10 < digits.size() && digits[point + 10] >= '5') ++ns;
  return negative ? -ns : ns;
}

void Place::fail(const std::string& why) const {
  throw ParseError(file, line, why);
}

std::size_t read_numbers(std::string_view& line, double* values, std::size_t capacity, const Place& place) {
  std::size_t count = 0;
  for (std::string_view word = next_word(line); !word.empty(); word = next_word(line)) {
    double value = 0.0;
    switch (parse_double(word, value)) {
      case Number::kNotANumber:
        place.fail(quoted(word) + " is not a number");
      case Number::kNotFinite:
        place.fail(quoted(word) + " is not finite");
      case Number::kOk:
        break;
    }
    if (count < capacity) values[count] = value;
    ++count;
  }
  return count;
}

Pose pose_of(const double* v, const Place& place) {
  Eigen::Quaterniond q(v[6], v[3], v[4], v[5]);
  // Divided by the largest element first, because the squares of 1e200 and of 1e-200 leave the range of a
  // double.
  const double largest = q.coeffs().cwiseAbs().maxCoeff();
  if (largest < 1e-9) place.fail("zero quaternion");
  q.coeffs() /= largest;
  const double norm = q.norm() * largest;
  q.normalize();
  Pose out{Eigen::Isometry3d::Identity(), std::abs(norm - 1.0) <= 1e-3};
  out.pose.linear() = q.toRotationMatrix();
  out.pose.translation() << v[0], v[1], v[2];
  return out;
}

Rigid rigid_of(const double* v, const Place& place) {
  Eigen::Matrix3d R;
  R << v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10];
  const double off = se3::rotation_defect(R);
  if (off > 0.1) place.fail("the 3x3 part is not a rotation matrix");
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Rigid out{Eigen::Isometry3d::Identity(), off <= 1e-3};
  out.pose.linear() = svd.matrixU() * svd.matrixV().transpose();
  out.pose.translation() << v[3], v[7], v[11];
  return out;
}

namespace {

template <class T>
void append_number(std::string& out, T value) {
  char digits[32];
  const auto result = std::to_chars(digits, digits + sizeof(digits), value);
  out.append(digits, result.ptr);
}

}  // namespace

void append(std::string& out, double value) {
  append_number(out, value == 0.0 ? 0.0 : value);
}
void append(std::string& out, float value) {
  append_number(out, value == 0.0f ? 0.0f : value);
}
void append(std::string& out, std::uint64_t value) {
  append_number(out, value);
}

void append_pose(std::string& out, const Eigen::Isometry3d& pose, char separator) {
  Eigen::Quaterniond q(pose.linear());
  q.normalize();
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const Eigen::Vector3d t = pose.translation();
  for (const double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z()}) {
    append(out, value);
    out += separator;
  }
  append(out, q.w());
}

bool has_only_digits(std::string_view text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

}  // namespace loopwise::text
