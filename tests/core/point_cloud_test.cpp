// SPDX-License-Identifier: BSD-3-Clause
// Included first and without other headers of the library: it must be self-contained.
#include <loopwise/core/point_cloud.hpp>

#include <array>
#include <cstdint>
#include <cstring>
#include <deque>
#include <limits>
#include <string>
#include <vector>

#include "testing.hpp"

namespace other {

/// A point of another program: padding before and between, normals beside it.
struct Echo {
  double time = 0.0;
  float x = 0, y = 0, z = 0;
  std::uint16_t ring = 0;
  float nx = 0, ny = 0, nz = 0;
};

/// As the point types of PCL.
struct PointNormal {
  float x = 0, y = 0, z = 0, padding = 0;
  float normal_x = 0, normal_y = 0, normal_z = 0, more_padding = 0;
};
struct Normal {
  float normal_x = 0, normal_y = 0, normal_z = 0, curvature = 0;
};

struct Whole {
  int x = 0, y = 0, z = 0;
};

/// Elements that are made when they are read.
class Generated {
 public:
  [[nodiscard]] std::size_t size() const { return 3; }
  [[nodiscard]] std::array<double, 3> operator[](std::size_t i) const {
    const auto d = static_cast<double>(i);
    return {d, d + 0.5, d + 0.25};
  }
};

/// A cloud without operator[].
struct Sweep {
  std::vector<double> xyz;
};

/// As sensor_msgs/PointCloud2.
struct Field {
  std::string name;
  std::uint32_t offset = 0;
  std::uint8_t datatype = 0;
  std::uint32_t count = 1;
};
struct Message {
  std::uint32_t height = 1, width = 0;
  std::vector<Field> fields;
  bool is_bigendian = false;
  std::uint32_t point_step = 0, row_step = 0;
  std::vector<std::uint8_t> data;
  bool is_dense = true;
};

}  // namespace other

namespace loopwise {

template <>
struct PointCloudTraits<other::Sweep> {
  static std::size_t size(const other::Sweep& sweep) { return sweep.xyz.size() / 3; }
  static Eigen::Vector3d point(const other::Sweep& sweep, std::size_t i) {
    return Eigen::Map<const Eigen::Vector3d>(sweep.xyz.data() + 3 * i);
  }
};

}  // namespace loopwise

namespace loopwise::point_cloud_test {

namespace {

using Points = std::vector<Eigen::Vector3f>;

// A type converts if and only if it can be read, so that overloads choose by it.
static_assert(std::is_convertible_v<Points, PointView>);
static_assert(std::is_convertible_v<other::Sweep, PointView>);
static_assert(std::is_convertible_v<other::Message, PointNormalView>);
static_assert(std::is_convertible_v<std::vector<other::PointNormal>, PointNormalView>);
static_assert(std::is_convertible_v<PointCloud, PointNormalView>);
static_assert(!std::is_convertible_v<std::vector<other::Echo>, PointNormalView>);
static_assert(!std::is_convertible_v<Points, PointNormalView>);
static_assert(!std::is_convertible_v<int, PointView>);
static_assert(!std::is_convertible_v<std::string, PointView>);
static_assert(!std::is_convertible_v<std::vector<double>, PointView>);

/// Three points whose coordinates are exact in every type.
Points three_points() {
  return {{1.0F, 2.0F, 3.0F}, {-4.0F, 5.0F, -6.0F}, {7.0F, -8.0F, 9.0F}};
}

void require_points(PointView view, const Points& expected = three_points()) {
  REQUIRE(view.size() == expected.size());
  REQUIRE(view.empty() == expected.empty());
  for (std::size_t i = 0; i < view.size(); ++i) REQUIRE(view[i] == expected[i].cast<double>());
}

template <class Element>
std::vector<Element> elements() {
  std::vector<Element> out;
  for (const Eigen::Vector3f& p : three_points()) {
    out.emplace_back();
    out.back().x = static_cast<decltype(Element::x)>(p.x());
    out.back().y = static_cast<decltype(Element::y)>(p.y());
    out.back().z = static_cast<decltype(Element::z)>(p.z());
  }
  return out;
}

/// A message with fields in another order than x, y, z, and points of an odd number of bytes.
template <class Scalar>
other::Message message(std::uint8_t datatype) {
  other::Message out;
  constexpr auto kBytes = static_cast<std::uint32_t>(sizeof(Scalar));
  out.fields = {
      {"ring", 0, 2}, {"z", 1, datatype}, {"x", 1 + kBytes, datatype}, {"y", 3 + 2 * kBytes, datatype}};
  out.point_step = 5 + 3 * kBytes;
  const Points points = three_points();
  out.width = static_cast<std::uint32_t>(points.size());
  out.row_step = out.point_step * out.width;
  out.data.assign(out.row_step, 0xff);
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (const auto& [field, axis] : {std::pair(1, 2), std::pair(2, 0), std::pair(3, 1)}) {
      const auto value = static_cast<Scalar>(points[i][axis]);
      std::memcpy(out.data.data() + i * out.point_step + out.fields[static_cast<std::size_t>(field)].offset,
                  &value, sizeof value);
    }
  }
  return out;
}

TEST_CASE("PointView: containers of elements with coordinates", "[point_cloud]") {
  const auto echoes = elements<other::Echo>();
  require_points(echoes);
  REQUIRE(PointView(echoes).is_single());
  require_points(elements<other::PointNormal>());
  require_points(elements<other::Whole>());
  REQUIRE_FALSE(PointView(elements<other::Whole>()).is_single());

  std::vector<std::array<double, 3>> arrays;
  std::vector<Eigen::Vector4f> padded;
  std::vector<std::vector<float>> apart;  // numbers that lie elsewhere, as many points apart as they like
  std::deque<Eigen::Vector3d> deque;
  for (const Eigen::Vector3f& p : three_points()) {
    arrays.push_back({static_cast<double>(p.x()), static_cast<double>(p.y()), static_cast<double>(p.z())});
    padded.emplace_back(p.x(), p.y(), p.z(), 1.0F);
    apart.push_back({p.x(), p.y(), p.z()});
    deque.push_back(p.cast<double>());
  }
  require_points(arrays);
  require_points(padded);
  require_points(apart);
  require_points(deque);
  require_points(other::Generated(), {{0.0F, 0.5F, 0.25F}, {1.0F, 1.5F, 1.25F}, {2.0F, 2.5F, 2.25F}});
  require_points(other::Sweep{{1, 2, 3, -4, 5, -6, 7, -8, 9}});
  require_points(std::vector<other::Echo>(), {});
  require_points(Points(), {});
  require_points(other::Sweep(), {});
}

TEST_CASE("PointView: reads points where they are", "[point_cloud]") {
  Points points = three_points();
  const PointView view = points;
  REQUIRE(view.array() == points.data());
  auto echoes = elements<other::Echo>();
  const PointView strided = echoes;
  REQUIRE(strided.array() == nullptr);
  other::Message words = message<float>(7);
  const PointView bytes = words;
  points[1].x() = echoes[1].x = 11.0F;
  words.data.assign(words.data.size(), 0);
  REQUIRE(view[1].x() == 11.0);
  REQUIRE(strided[1].x() == 11.0);
  REQUIRE(bytes[2].isZero(0.0));
}

TEST_CASE("PointView: members of elements by name, and normals", "[point_cloud]") {
  auto echoes = elements<other::Echo>();
  std::vector<other::Normal> normals(3);
  for (std::size_t i = 0; i < 3; ++i) {
    echoes[i].ny = normals[i].normal_y = 0.25F * static_cast<float>(i);
    echoes[i].nz = normals[i].normal_z = 1.0F;
  }
  const Points expected{{0, 0, 1}, {0, 0.25F, 1}, {0, 0.5F, 1}};
  const PointView members(echoes, &other::Echo::nx, &other::Echo::ny, &other::Echo::nz);
  require_points(members, expected);
  require_points(normals, expected);
  require_points(PointView(std::vector<other::Echo>(), &other::Echo::nx, &other::Echo::ny, &other::Echo::nz),
                 {});

  const PointNormalView both(echoes, members);
  require_points(both.points());
  require_points(both.normals(), expected);
  auto pcl = elements<other::PointNormal>();
  for (std::size_t i = 0; i < 3; ++i) {
    pcl[i].normal_x = 0.0F;
    pcl[i].normal_y = expected[i].y();
    pcl[i].normal_z = 1.0F;
  }
  const PointNormalView of_pcl = pcl;
  require_points(of_pcl.points());
  require_points(of_pcl.normals(), expected);
  REQUIRE_THROWS_WITH(PointNormalView(echoes, Points(2)),
                      "3 points with 2 normals: each point needs a normal, see "
                      "estimate_normals()");
}

TEST_CASE("PointView: matrices of three rows, in any order of memory", "[point_cloud]") {
  Eigen::Matrix3Xf single(3, 3);
  for (Eigen::Index i = 0; i < 3; ++i) single.col(i) = three_points()[static_cast<std::size_t>(i)];
  require_points(single);
  const Eigen::MatrixXd dynamic = single.cast<double>();
  require_points(dynamic);
  const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> rows = dynamic.transpose();
  require_points(rows.transpose());
  const Eigen::Matrix<float, 3, Eigen::Dynamic, Eigen::RowMajor> row_major = single;
  require_points(row_major);
  Eigen::MatrixXf larger = Eigen::MatrixXf::Zero(7, 5);
  larger.block(2, 1, 3, 3) = single;
  require_points(larger.block(2, 1, 3, 3));
  require_points(Eigen::Matrix3Xi(single.cast<int>()));
  require_points(0.5 * (2.0 * dynamic));
  require_points(Eigen::Matrix3Xf(3, 0), {});
  REQUIRE_THROWS_WITH(PointView(Eigen::MatrixXd(Eigen::MatrixXd::Zero(4, 3))),
                      "a matrix of points has 3 rows, one column for each point; found 4 rows: pass its "
                      "transpose if points are rows");
}

TEST_CASE("PointView: a cloud of the library with its origin", "[point_cloud]") {
  PointCloud cloud;
  cloud.points = three_points();
  REQUIRE(PointView(cloud).array() == cloud.points.data());
  require_points(cloud);
  cloud.origin = Eigen::Vector3d(4e6, 0.0, 0.125);
  const PointView view = cloud;
  REQUIRE(view[2] == Eigen::Vector3d(4e6 + 7.0, -8.0, 9.125));
  REQUIRE_FALSE(view.is_single());
  REQUIRE_THROWS_WITH(PointNormalView(cloud), Contains("3 points with 0 normals"));
}

TEST_CASE("PointView: messages of ROS, by the names of their fields", "[point_cloud]") {
  require_points(message<float>(7));
  REQUIRE(PointView(message<float>(7)).is_single());
  require_points(message<double>(8));
  REQUIRE_FALSE(PointView(message<double>(8)).is_single());

  other::Message rows = message<float>(7);
  rows.height = 3;
  rows.width = 1;
  rows.row_step = rows.point_step;
  require_points(rows);
  other::Message normals = message<float>(7);
  for (std::size_t f = 1; f < 4; ++f) {
    normals.fields.push_back(normals.fields[f]);
    normals.fields.back().name = "normal_" + normals.fields[f].name;
  }
  require_points(PointNormalView(normals).normals());

  rows.row_step += 8;
  REQUIRE_THROWS_WITH(PointView(rows),
                      "PointCloud2: row_step = 25, must be point_step · width = 17: copy the rows "
                      "without their padding");
  other::Message bad = message<float>(7);
  bad.fields.pop_back();
  REQUIRE_THROWS_WITH(PointView(bad), "PointCloud2: there is no field y");
  bad = message<float>(7);
  bad.fields[3].datatype = 5;
  REQUIRE_THROWS_WITH(PointView(bad), Contains("field y is neither FLOAT32 nor FLOAT64"));
  bad.fields[3].datatype = 8;
  REQUIRE_THROWS_WITH(PointView(bad), Contains("field y has another type than x"));
  bad = message<float>(7);
  bad.is_bigendian = true;
  REQUIRE_THROWS_WITH(PointView(bad), Contains("is_bigendian"));
  bad = message<float>(7);
  bad.data.resize(20);
  REQUIRE_THROWS_WITH(PointView(bad),
                      "PointBuffer: 3 points with a stride of 17 bytes do not fill 20 bytes: set points "
                      "to width · height and stride to point_step, and copy rows that have padding");
  REQUIRE_THROWS_WITH(PointNormalView(message<float>(7)), Contains("there is no field normal_x"));
}

TEST_CASE("PointBuffer: offsets and stride are checked", "[point_cloud][error]") {
  const auto echoes = elements<other::Echo>();
  PointBuffer buffer;
  REQUIRE(PointView(buffer).empty());
  buffer.data = echoes.data();
  buffer.bytes = echoes.size() * sizeof(other::Echo);
  buffer.points = echoes.size();
  buffer.stride = sizeof(other::Echo);
  buffer.offsets = {8, 12, 16};
  require_points(buffer);

  const auto with = [&](auto change) {
    PointBuffer other = buffer;
    change(other);
    return other;
  };
  REQUIRE_THROWS_WITH(
      PointView(with([](PointBuffer& b) { b.stride = 12; })),
      "PointBuffer: stride = 12 bytes, but a coordinate of 4 bytes begins at 16: set stride to "
      "point_step, and offsets to those of x, y, z");
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) { b.stride = 0; })), InputError);
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) { b.stride += 1; })), InputError);
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) { b.points = 2; })), InputError);
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) { b.points = ~std::size_t{0}; })), InputError);
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) { b.offsets[1] = ~std::size_t{0}; })), InputError);
  REQUIRE_THROWS_AS(PointView(with([](PointBuffer& b) {
                      b.type = CoordinateType::kDouble;
                      b.offsets = {8, 16, 34};
                    })),
                    InputError);
  REQUIRE_THROWS_WITH(PointView(with([](PointBuffer& b) { b.data = nullptr; })), "PointBuffer: data is null");
}

}  // namespace
}  // namespace loopwise::point_cloud_test
