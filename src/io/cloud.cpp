// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/cloud.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "cloud_points.hpp"
#include "file_kind.hpp"
#include "lzf.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;
using namespace points;

constexpr std::string_view kOriginComment = "loopwise origin ";
constexpr double kFarthestOrigin_m = 1e9;

std::uint64_t count_value(std::string_view word, const text::Place& place) {
  std::uint64_t value = 0;
  if (const char* why = text::parse_id(word, value))
    place.fail(text::quoted(word) + " " + why + ", expected a count");
  return value;
}

/// Reads one line of ascii values. "nan" and "inf" are valid values; their points are dropped later.
void read_ascii_point(const std::vector<Channel>& channel_of_word, std::string_view line,
                      const text::Place& place, double* channels) {
  std::size_t words = 0;
  for (std::string_view word = text::next_word(line); !word.empty(); word = text::next_word(line), ++words) {
    double value = 0.0;
    const text::Number parsed = text::parse_double(word, value);
    if (parsed == text::Number::kNotANumber) place.fail(text::quoted(word) + " is not a number");
    if (parsed == text::Number::kNotFinite) value = std::numeric_limits<double>::quiet_NaN();
    if (words < channel_of_word.size() && channel_of_word[words] != kChannels) {
      channels[channel_of_word[words]] = value;
    }
  }
  if (words != channel_of_word.size()) {
    place.fail("a point needs " + std::to_string(channel_of_word.size()) + " values, found " +
               std::to_string(words));
  }
}

/// Call this only when the data are known to contain a point: the memory grows with the stated counts of
/// fields, and a file may state any counts.
std::vector<Channel> channels_by_word(const Layout& layout) {
  std::vector<Channel> out(layout.point_words, kChannels);
  const auto used = layout.used();
  std::size_t word = 0;
  for (const Field& field : layout.fields) {
    for (const auto& [channel, own] : used) {
      if (own == &field) out[word] = channel;
    }
    word += field.count;
  }
  return out;
}

std::string truncated(const std::string& file, std::uint64_t points, std::size_t needed, std::size_t found) {
  return file + ": " + std::to_string(points) + " points need " + std::to_string(needed) + " bytes, found " +
         std::to_string(found) + ": the file is cut short or its header is wrong";
}

/// Reads the origin of the points from a comment, where our writers put it.
void read_origin(std::string_view comment, const text::Place& place, std::optional<Eigen::Vector3d>& origin) {
  while (!comment.empty() && (comment.front() == '#' || comment.front() == ' ')) comment.remove_prefix(1);
  if (comment.substr(0, kOriginComment.size()) != kOriginComment) return;
  comment.remove_prefix(kOriginComment.size());
  double values[3] = {};
  if (text::read_numbers(comment, values, 3, place) != 3) place.fail("the origin needs 3 values");
  const Eigen::Vector3d stated(values[0], values[1], values[2]);
  if (stated.cwiseAbs().maxCoeff() > kFarthestOrigin_m) place.fail("the origin is out of range");
  origin = stated;
}

// ---- PCD ----

struct PcdHeader {
  Layout layout;
  std::uint64_t points = 0;
  PcdEncoding encoding = PcdEncoding::kAscii;
  std::size_t data_begin = 0;  // byte
  std::size_t data_line = 0;   // number of the DATA line
  bool moved_viewpoint = false;
  std::optional<Eigen::Vector3d> origin;
};

Scalar pcd_scalar(std::string_view type, std::uint64_t size, const text::Place& place) {
  const char t = type.size() == 1 ? type[0] : '?';
  if (t == 'F' && size == 4) return Scalar::kFloat32;
  if (t == 'F' && size == 8) return Scalar::kFloat64;
  constexpr Scalar kSigned[] = {Scalar::kInt8, Scalar::kInt16, Scalar::kInt32, Scalar::kInt64};
  constexpr Scalar kUnsigned[] = {Scalar::kUint8, Scalar::kUint16, Scalar::kUint32, Scalar::kUint64};
  for (std::size_t i = 0; i < 4; ++i) {
    if (size == std::uint64_t{1} << i && t == 'I') return kSigned[i];
    if (size == std::uint64_t{1} << i && t == 'U') return kUnsigned[i];
  }
  place.fail("unsupported TYPE " + text::quoted(type) + " with SIZE " + std::to_string(size));
}

/// Lines of a PCD header as they stand in the file.
struct PcdLines {
  std::vector<std::string_view> names, types;
  std::vector<std::uint64_t> sizes, counts;
  std::optional<std::uint64_t> width, height, points;
  std::size_t types_line = 1;  ///< For errors.
};

using Words = std::vector<std::string_view>;

bool is_moved_viewpoint(const Words& words) {
  constexpr double kIdentity[] = {0, 0, 0, 1, 0, 0, 0};
  for (std::size_t i = 0; i < words.size(); ++i) {
    double value = 0.0;
    if (i >= 7 || text::parse_double(words[i], value) != text::Number::kOk || value != kIdentity[i])
      return true;
  }
  return false;
}

/// Reads one line but DATA.
void read_pcd_line(std::string_view keyword, const Words& words, const text::Place& place, PcdLines& lines,
                   PcdHeader& header) {
  const auto one_count = [&] {
    if (words.size() != 1) place.fail(std::string(keyword) + " needs one value");
    return count_value(words[0], place);
  };
  if (keyword == "FIELDS" || keyword == "COLUMNS") {
    lines.names = words;
  } else if (keyword == "SIZE") {
    for (const auto w : words) lines.sizes.push_back(count_value(w, place));
  } else if (keyword == "TYPE") {
    lines.types = words;
    lines.types_line = place.line;
  } else if (keyword == "COUNT") {
    for (const auto w : words) lines.counts.push_back(count_value(w, place));
  } else if (keyword == "WIDTH") {
    lines.width = one_count();
  } else if (keyword == "HEIGHT") {
    lines.height = one_count();
  } else if (keyword == "VIEWPOINT") {
    header.moved_viewpoint = header.moved_viewpoint || is_moved_viewpoint(words);
  } else if (keyword == "POINTS") {
    lines.points = one_count();
  } else if (keyword != "VERSION") {
    place.fail("unknown keyword " + text::quoted(keyword) + " in the PCD header");
  }
}

PcdEncoding pcd_encoding(const Words& words, const text::Place& place) {
  if (words.size() != 1) place.fail("DATA needs one value");
  try {
    return parse_enum<PcdEncoding>("DATA", words[0]);
  } catch (const OptionError& error) {
    place.fail(error.what());
  }
}

Layout pcd_layout(const std::string& file, const PcdLines& lines) {
  const text::Place place{file, lines.types_line};
  const std::size_t fields = lines.names.size();
  if (fields == 0 || lines.sizes.size() != fields || lines.types.size() != fields ||
      (!lines.counts.empty() && lines.counts.size() != fields)) {
    place.fail("FIELDS, SIZE, TYPE and COUNT must have as many values, found " + std::to_string(fields) +
               ", " + std::to_string(lines.sizes.size()) + ", " + std::to_string(lines.types.size()) + ", " +
               std::to_string(lines.counts.size()));
  }
  Layout layout;
  for (std::size_t i = 0; i < fields; ++i) {
    const std::uint64_t count = lines.counts.empty() ? 1 : lines.counts[i];
    if (count > 65536) place.fail("COUNT " + std::to_string(count) + " is too large");
    layout.fields.push_back({std::string(lines.names[i]), pcd_scalar(lines.types[i], lines.sizes[i], place),
                             static_cast<std::size_t>(count), 0});
  }
  layout.pack(file);
  return layout;
}

std::uint64_t pcd_points(const std::string& file, const PcdLines& lines) {
  if (!lines.width && !lines.points) throw InputError(file + ": the header has neither WIDTH nor POINTS");
  const std::uint64_t rows = lines.height.value_or(1);
  const std::uint64_t columns = lines.width.value_or(lines.points.value_or(0));
  const bool overflow = rows != 0 && columns > std::numeric_limits<std::uint64_t>::max() / rows;
  if (overflow || (lines.points && rows * columns != *lines.points)) {
    throw InputError(file + ": WIDTH " + std::to_string(columns) + " and HEIGHT " + std::to_string(rows) +
                     " do not multiply to POINTS " + std::to_string(lines.points.value_or(0)));
  }
  return rows * columns;
}

PcdHeader read_pcd_header(const std::string& file, std::string_view contents) {
  PcdHeader header;
  PcdLines found;
  text::Lines lines(contents);
  for (std::string_view line; header.data_line == 0 && lines.next(line);) {
    const text::Place place{file, lines.number()};
    if (!line.empty() && line.front() == '#') read_origin(line, place, header.origin);
    const std::string_view keyword = text::next_word(line);
    if (keyword.empty()) continue;
    Words words;
    for (std::string_view w = text::next_word(line); !w.empty(); w = text::next_word(line))
      words.push_back(w);
    if (keyword != "DATA") {
      read_pcd_line(keyword, words, place, found, header);
      continue;
    }
    header.encoding = pcd_encoding(words, place);
    if (!lines.ended()) place.fail("the file ends after the header");
    header.data_line = lines.number();
    header.data_begin = static_cast<std::size_t>(lines.rest().data() - contents.data());
  }
  if (header.data_line == 0)
    throw InputError(file + ": no DATA line: the file is empty, cut short or not a PCD file");
  header.layout = pcd_layout(file, found);
  header.points = pcd_points(file, found);
  return header;
}

CloudFile read_pcd(const std::string& file, const std::string& contents) {
  const PcdHeader header = read_pcd_header(file, contents);
  const Layout& layout = header.layout;
  const std::string_view data = std::string_view(contents).substr(header.data_begin);
  CloudBuilder builder(file, layout.has_normals(), layout.has_intensity());
  if (header.moved_viewpoint) builder.add_problem("viewpoint ignored", file);

  const std::size_t least =
      header.encoding == PcdEncoding::kAscii ? 2 * layout.point_words - 1 : layout.point_size;
  if (header.encoding != PcdEncoding::kBinaryCompressed && header.points > (data.size() + 1) / least) {
    const bool countable = header.points <= std::numeric_limits<std::size_t>::max() / least;
    throw InputError(countable ? truncated(file, header.points, least * header.points, data.size())
                               : file + ": POINTS " + std::to_string(header.points) +
                                     " is more than a file can hold");
  }
  const auto count = static_cast<std::size_t>(header.points);

  if (header.encoding == PcdEncoding::kAscii) {
    const std::vector<Channel> channel_of_word =
        count > 0 ? channels_by_word(layout) : std::vector<Channel>();
    double channels[kChannels] = {};
    std::size_t found = 0;
    builder.reserve(count);
    text::Lines lines(data);
    for (std::string_view line; lines.next(line);) {
      std::string_view look = line;
      if (text::next_word(look).empty()) continue;
      const text::Place place{file, header.data_line + lines.number()};
      if (found++ == count) place.fail("more points than the header's " + std::to_string(count));
      read_ascii_point(channel_of_word, line, place, channels);
      builder.add(channels);
    }
    if (found != count) {
      throw InputError(file + ": " + std::to_string(found) + " points, the header says " +
                       std::to_string(count));
    }
    if (!lines.ended()) builder.add_problem("no line end after the last line", file);
  } else if (header.encoding == PcdEncoding::kBinary) {
    if (data.size() < count * layout.point_size) {
      throw InputError(truncated(file, count, count * layout.point_size, data.size()));
    }
    read_binary(layout, data, count, true, big_endian_host(), builder);
  } else if (count > 0 || data.size() >= 8) {
    if (data.size() < 8) throw InputError(truncated(file, count, 8, data.size()));
    const auto compressed = static_cast<std::size_t>(load(Scalar::kUint32, data.data(), big_endian_host()));
    const auto expanded = static_cast<std::size_t>(load(Scalar::kUint32, data.data() + 4, big_endian_host()));
    if (count > expanded / layout.point_size || expanded != count * layout.point_size) {
      throw InputError(file + ": " + std::to_string(expanded) + " bytes of data for " +
                       std::to_string(count) + " points of " + std::to_string(layout.point_size));
    }
    if (compressed > data.size() - 8 || expanded > lzf_largest_output(compressed)) {
      throw InputError(truncated(file, count, compressed, data.size() - 8));
    }
    std::string fields(expanded, '\0');
    if (!lzf_decompress(data.substr(8, compressed), fields))
      throw InputError(file + ": compressed data are damaged");
    read_binary(layout, fields, count, false, big_endian_host(), builder);
  }
  return builder.finish(header.origin);
}

// ---- PLY ----

Scalar ply_scalar(std::string_view type, const text::Place& place) {
  struct Name {
    std::string_view old_name, new_name;
    Scalar scalar;
  };
  constexpr Name kNames[] = {{"char", "int8", Scalar::kInt8},        {"uchar", "uint8", Scalar::kUint8},
                             {"short", "int16", Scalar::kInt16},     {"ushort", "uint16", Scalar::kUint16},
                             {"int", "int32", Scalar::kInt32},       {"uint", "uint32", Scalar::kUint32},
                             {"float", "float32", Scalar::kFloat32}, {"double", "float64", Scalar::kFloat64}};
  for (const Name& name : kNames) {
    if (type == name.old_name || type == name.new_name) return name.scalar;
  }
  place.fail("unknown PLY type " + text::quoted(type));
}

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  Layout layout;
  bool has_list = false;
};

struct PlyHeader {
  enum class Format { kAscii, kLittleEndian, kBigEndian } format = Format::kAscii;
  std::vector<PlyElement> elements;
  std::size_t data_begin = 0;
  std::size_t data_line = 0;
  std::optional<Eigen::Vector3d> origin;
};

PlyHeader read_ply_header(const std::string& file, std::string_view contents) {
  PlyHeader header;
  text::Lines lines(contents);
  std::string_view line;
  if (!lines.next(line) || text::trim(line) != "ply") throw ParseError(file, 1, "is not a PLY file");
  bool has_format = false;
  while (lines.next(line)) {
    const text::Place place{file, lines.number()};
    const std::string_view keyword = text::next_word(line);
    if (keyword == "comment") read_origin(line, place, header.origin);
    if (keyword.empty() || keyword == "comment" || keyword == "obj_info") continue;
    if (keyword == "format") {
      const std::string_view word = text::next_word(line);
      has_format = true;
      if (word == "ascii") {
        header.format = PlyHeader::Format::kAscii;
      } else if (word == "binary_little_endian") {
        header.format = PlyHeader::Format::kLittleEndian;
      } else if (word == "binary_big_endian") {
        header.format = PlyHeader::Format::kBigEndian;
      } else {
        place.fail("unknown PLY format " + text::quoted(word));
      }
    } else if (keyword == "element") {
      PlyElement element;
      element.name = std::string(text::next_word(line));
      element.count = count_value(text::next_word(line), place);
      header.elements.push_back(std::move(element));
    } else if (keyword == "property") {
      if (header.elements.empty()) place.fail("a property without an element");
      PlyElement& element = header.elements.back();
      const std::string_view type = text::next_word(line);
      if (type == "list") {
        element.has_list = true;
      } else {
        const Scalar scalar = ply_scalar(type, place);
        element.layout.fields.push_back({std::string(text::next_word(line)), scalar, 1, 0});
      }
    } else if (keyword == "end_header") {
      if (!has_format) place.fail("the header has no format line");
      header.data_line = lines.number();
      header.data_begin = static_cast<std::size_t>(lines.rest().data() - contents.data());
      return header;
    } else {
      place.fail("unknown keyword " + text::quoted(keyword) + " in the PLY header");
    }
  }
  throw InputError(file + ": no end_header: the file is cut short");
}

CloudFile read_ply(const std::string& file, const std::string& contents) {
  PlyHeader header = read_ply_header(file, contents);
  const auto vertex = std::find_if(header.elements.begin(), header.elements.end(),
                                   [](const PlyElement& element) { return element.name == "vertex"; });
  if (vertex == header.elements.end()) throw InputError(file + ": no element vertex");
  if (vertex->has_list) throw InputError(file + ": vertices with lists are not supported");
  if (vertex != header.elements.begin()) throw InputError(file + ": vertices must be the first element");
  Layout& layout = vertex->layout;
  layout.pack(file);
  const std::string_view data = std::string_view(contents).substr(header.data_begin);
  const bool ascii = header.format == PlyHeader::Format::kAscii;
  const std::size_t least = ascii ? 2 * layout.point_words - 1 : layout.point_size;
  if (vertex->count > (data.size() + 1) / least) {
    throw InputError(file + ": " + std::to_string(vertex->count) + " points of at least " +
                     std::to_string(least) + " bytes in " + std::to_string(data.size()) +
                     ": the file is cut short or its header is wrong");
  }
  const auto count = static_cast<std::size_t>(vertex->count);
  CloudBuilder builder(file, layout.has_normals(), layout.has_intensity());
  if (ascii) {
    const std::vector<Channel> channel_of_word = channels_by_word(layout);
    double channels[kChannels] = {};
    std::size_t found = 0;
    builder.reserve(count);
    text::Lines lines(data);
    for (std::string_view line; found < count && lines.next(line);) {
      if (text::trim(line).empty()) continue;
      read_ascii_point(channel_of_word, line, {file, header.data_line + lines.number()}, channels);
      builder.add(channels);
      ++found;
    }
    if (found != count) {
      throw InputError(file + ": " + std::to_string(found) + " points, the header says " +
                       std::to_string(count));
    }
    if (!lines.ended()) builder.add_problem("no line end after the last line", file);
    for (std::string_view line; header.elements.size() == 1 && lines.next(line);) {
      if (!text::trim(line).empty()) {
        throw ParseError(file, header.data_line + lines.number(),
                         "more points than the header's " + std::to_string(count));
      }
    }
  } else {
    if (data.size() < count * layout.point_size) {
      throw InputError(truncated(file, count, count * layout.point_size, data.size()));
    }
    const bool big = header.format == PlyHeader::Format::kBigEndian;
    read_binary(layout, data, count, true, big != big_endian_host(), builder);
  }
  return builder.finish(header.origin);
}

// ---- Writers ----

/// The floats of the cloud, one column a field.
struct Column {
  const char* pcd_name;
  const char* ply_name;
  const float* first;
  std::size_t stride;  // floats
};

std::vector<Column> columns_of(const PointCloud& cloud) {
  std::vector<Column> columns;
  const bool has_points = !cloud.empty();
  const auto add = [&](const char* pcd, const char* ply, const float* data, std::size_t offset,
                       std::size_t stride) {
    columns.push_back({pcd, ply, has_points ? data + offset : nullptr, stride});
  };
  const float* xyz = has_points ? cloud.points[0].data() : nullptr;
  add("x", "x", xyz, 0, 3);
  add("y", "y", xyz, 1, 3);
  add("z", "z", xyz, 2, 3);
  if (has_points && cloud.intensities.size() == cloud.size()) {
    add("intensity", "intensity", cloud.intensities.data(), 0, 1);
  }
  if (cloud.has_normals()) {
    add("normal_x", "nx", cloud.normals[0].data(), 0, 3);
    add("normal_y", "ny", cloud.normals[0].data(), 1, 3);
    add("normal_z", "nz", cloud.normals[0].data(), 2, 3);
  }
  return columns;
}

void append_float(std::string& out, float value) {
  char bytes[sizeof(value)];
  std::memcpy(bytes, &value, sizeof(value));
  if (big_endian_host()) std::reverse(bytes, bytes + sizeof(bytes));
  out.append(bytes, sizeof(bytes));
}

void append_uint32(std::string& out, std::size_t value) {
  for (int shift = 0; shift < 32; shift += 8) out += static_cast<char>(value >> shift & 255);
}

void append_points(std::string& out, const std::vector<Column>& columns, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    for (const Column& column : columns) append_float(out, column.first[i * column.stride]);
  }
}

std::string repeated(const char* word, std::size_t count) {
  std::string out;
  for (std::size_t i = 0; i < count; ++i) out += std::string(" ") + word;
  return out;
}

}  // namespace

bool is_cloud_file(const fs::path& path) {
  const fs::path extension = path.extension();
  return extension == ".pcd" || extension == ".ply" || extension == ".bin";
}

CloudFile points::parse_cloud(const std::string& name, const std::string& contents, BinLayout bin_layout) {
  const fs::path extension = fs::path(name).extension();
  if (extension == ".pcd") {
    refuse_foreign(contents, name, {FileKind::kPcd, FileKind::kEmpty},
                   "a PCD cloud, because of its file extension");
    return read_pcd(name, contents);
  }
  if (extension == ".ply") {
    refuse_foreign(contents, name, {FileKind::kPly, FileKind::kEmpty},
                   "a PLY cloud, because of its file extension");
    return read_ply(name, contents);
  }
  if (extension == ".bin") {
    refuse_foreign_numbers(contents, name, "binary points without a header, because of its file extension");
    return read_bin(name, contents, bin_layout);
  }
  throw InputError(name + ": unknown file extension of a cloud, expected .pcd, .ply or .bin");
}

CloudFile read_cloud(const fs::path& path, BinLayout bin_layout) {
  if (!is_cloud_file(path)) {
    refuse_foreign_file(path, {FileKind::kPcd, FileKind::kPly, FileKind::kEmpty},
                        "a cloud in a file .pcd, .ply or .bin");
  }
  return parse_cloud(path.string(), is_cloud_file(path) ? read_file(path) : std::string(), bin_layout);
}

namespace {

/// Comment with the origin of the points; empty if it is zero.
std::string origin_comment(const char* start, const PointCloud& cloud) {
  if (cloud.origin.isZero(0.0)) return {};
  std::string out = start + std::string(kOriginComment);
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    text::append(out, cloud.origin[axis]);
    out += axis < 2 ? ' ' : '\n';
  }
  return out;
}

}  // namespace

std::string points::pcd_text(const PointCloud& cloud, PcdEncoding encoding) {
  const std::vector<Column> columns = columns_of(cloud);
  const std::size_t count = cloud.size();
  const std::string points = std::to_string(count);
  // Sizes of compressed data are 32-bit numbers.
  if (count * columns.size() > std::numeric_limits<std::uint32_t>::max() / 8) encoding = PcdEncoding::kBinary;
  std::string out =
      "# .PCD v0.7 - Point Cloud Data file format\n" + origin_comment("# ", cloud) + "VERSION 0.7\nFIELDS";
  for (const Column& column : columns) out += std::string(" ") + column.pcd_name;
  out += "\nSIZE" + repeated("4", columns.size()) + "\nTYPE" + repeated("F", columns.size()) + "\nCOUNT" +
         repeated("1", columns.size()) + "\nWIDTH " + points +
         "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + points + "\nDATA " + enum_name(encoding) + "\n";
  if (encoding == PcdEncoding::kAscii) {
    for (std::size_t i = 0; i < count; ++i) {
      for (const Column& column : columns) {
        text::append(out, column.first[i * column.stride]);
        out += &column == &columns.back() ? '\n' : ' ';
      }
    }
  } else if (encoding == PcdEncoding::kBinary) {
    append_points(out, columns, count);
  } else if (count > 0) {
    std::string fields;
    fields.reserve(4 * columns.size() * count);
    for (const Column& column : columns) append_points(fields, {column}, count);
    const std::string compressed = lzf_compress(fields);
    append_uint32(out, compressed.size());
    append_uint32(out, fields.size());
    out += compressed;
  }
  return out;
}

void write_pcd(const fs::path& path, const PointCloud& cloud, PcdEncoding encoding) {
  write_file(path, points::pcd_text(cloud, encoding));
}

void write_ply(const fs::path& path, const PointCloud& cloud) {
  const std::vector<Column> columns = columns_of(cloud);
  std::string out = "ply\nformat binary_little_endian 1.0\n" + origin_comment("comment ", cloud) +
                    "element vertex " + std::to_string(cloud.size()) + "\n";
  for (const Column& column : columns) out += std::string("property float ") + column.ply_name + "\n";
  out += "end_header\n";
  append_points(out, columns, cloud.size());
  write_file(path, out);
}

}  // namespace loopwise
