// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Clouds of any type as input: algorithms take a PointView, which reads the points where they are.
///
///     pcl::PointCloud<pcl::PointXYZI> scan;                        // or any cloud that PointView names
///     const loopwise::KdTree tree(scan);
///     const auto normals = loopwise::estimate_normals(scan, tree);
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>

#include <Eigen/Core>

#include <loopwise/core/error.hpp>
#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

template <class Cloud, class = void>
struct PointCloudTraits;

/// Type of the coordinates in a PointBuffer, in the byte order of the machine.
enum class CoordinateType {
  kFloat,  ///< 32 bits; FLOAT32 (7) in sensor_msgs/PointField.
  kDouble  ///< 64 bits; FLOAT64 (8) in sensor_msgs/PointField.
};

/// A buffer of bytes with points at a fixed distance and their coordinates at fixed offsets, as in
/// sensor_msgs/PointCloud2. Bytes need not be aligned.
struct PointBuffer {
  const void* data = nullptr;  ///< The first point: `data.data()` of PointCloud2.
  std::size_t bytes = 0;       ///< Size of the buffer: `data.size()`. Equals points · stride.
  std::size_t points = 0;      ///< Number of points: `width · height`.
  std::size_t stride = 0;      ///< From a point to the next, bytes: `point_step`.
  std::array<std::size_t, 3> offsets{0, 4, 8};   ///< Of x, y and z from the start of a point, bytes.
  CoordinateType type = CoordinateType::kFloat;  ///< Of x, y and z.
};

namespace detail {

/// Ways to read an element, the preferred one last.
struct AsNumbers {};
struct AsNormal : AsNumbers {};
struct AsPoint : AsNormal {};

/// The coordinates of an element of a cloud: its members x, y, z, or the normal of an element without these,
/// or its first three numbers. References, where the element has the numbers in memory.
template <class Point>
[[nodiscard]] auto coordinates(const Point& p, AsPoint)
    -> std::tuple<decltype((p.x)), decltype((p.y)), decltype((p.z))> {
  return {p.x, p.y, p.z};
}
template <class Point>
[[nodiscard]] auto coordinates(const Point& p, AsNormal)
    -> std::tuple<decltype((p.normal_x)), decltype((p.normal_y)), decltype((p.normal_z))> {
  return {p.normal_x, p.normal_y, p.normal_z};
}
template <class Point>
[[nodiscard]] auto coordinates(const Point& p, AsNumbers)
    -> std::tuple<decltype(p[0]), decltype(p[1]), decltype(p[2])> {
  return {p[0], p[1], p[2]};
}

template <class Way, class Point>
[[nodiscard]] Eigen::Vector3d vector_of(const Point& p) {
  const auto c = coordinates(p, Way());
  return {static_cast<double>(std::get<0>(c)), static_cast<double>(std::get<1>(c)),
          static_cast<double>(std::get<2>(c))};
}

template <class Cloud>
using ElementOf = std::decay_t<decltype(std::declval<const Cloud&>()[0])>;

/// Whether a type has size() and operator[] with elements that have coordinates.
template <class Cloud, class = void>
struct HasPoints : std::false_type {};
template <class Cloud>
struct HasPoints<Cloud,
                 std::void_t<decltype(static_cast<std::size_t>(std::declval<const Cloud&>().size())),
                             decltype(coordinates(std::declval<const ElementOf<Cloud>&>(), AsPoint()))>>
    : std::true_type {};

/// Whether the elements have the normals of PCL's point types.
template <class Cloud, class = void>
struct HasNormals : std::false_type {};
template <class Cloud>
struct HasNormals<Cloud, std::void_t<decltype(std::declval<const ElementOf<Cloud>&>().normal_x)>>
    : HasPoints<Cloud> {};

/// Whether the elements are one after another in memory.
template <class Cloud, class = void>
struct IsContiguous : std::false_type {};
template <class Cloud>
struct IsContiguous<Cloud, std::void_t<decltype(std::declval<const Cloud&>().data())>>
    : std::is_same<decltype(std::declval<const Cloud&>().data()), const ElementOf<Cloud>*> {};

/// Whether a type has the members of sensor_msgs/PointCloud2 (ROS 1, ROS 2, pcl::PCLPointCloud2).
template <class Message, class = void>
struct IsMessage : std::false_type {};
template <class Message>
struct IsMessage<Message, std::void_t<decltype(std::declval<const Message&>().point_step),
                                      decltype(std::declval<const Message&>().row_step),
                                      decltype(std::declval<const Message&>().is_bigendian),
                                      decltype(std::declval<const Message&>().data.data()),
                                      decltype(std::declval<const Message&>().fields.begin()->datatype)>>
    : std::true_type {};

/// Float or double, if all three coordinates are references to that type in memory; otherwise void.
template <class Coordinates>
struct ScalarInMemory {
  using type = void;
};
template <>
struct ScalarInMemory<std::tuple<const float&, const float&, const float&>> {
  using type = float;
};
template <>
struct ScalarInMemory<std::tuple<const double&, const double&, const double&>> {
  using type = double;
};

/// Whether PointCloudTraits reads a type: a specialisation of the user does not have kReadable.
template <class Cloud, class = void>
struct IsCloud : std::true_type {};
template <class Cloud>
struct IsCloud<Cloud, std::void_t<decltype(PointCloudTraits<Cloud>::kReadable)>>
    : std::bool_constant<PointCloudTraits<Cloud>::kReadable> {};

template <class Cloud, class = void>
struct HasView : std::false_type {};
template <class Cloud>
struct HasView<Cloud, std::void_t<decltype(PointCloudTraits<Cloud>::view(std::declval<const Cloud&>()))>>
    : std::true_type {};

template <class Cloud, class = void>
struct HasNormalView : std::false_type {};
template <class Cloud>
struct HasNormalView<Cloud,
                     std::void_t<decltype(PointCloudTraits<Cloud>::normals(std::declval<const Cloud&>()))>>
    : std::true_type {};

}  // namespace detail

/// Points, or vectors as normals, in the memory of their owner, which must outlive the view. Small: pass it
/// by value. A cloud converts to it without a copy if PointCloudTraits reads its type:
///
///   - containers with size() and operator[] whose elements have members x, y, z (pcl::PointCloud, vectors of
///     structs) or three or more numbers (Eigen vectors, std::array); of elements that have only normal_x,
///     normal_y, normal_z (pcl::Normal) these are viewed;
///   - Eigen matrices of three rows, one column for each point;
///   - messages sensor_msgs/PointCloud2 of ROS 1, of ROS 2 or of PCL, and PointBuffer;
///   - PointCloud of this library; and your own types, by a specialisation of PointCloudTraits.
///
/// Points that are not finite may be among the points: algorithms leave them out. Indices count them.
class LOOPWISE_EXPORT PointView {
 public:
  /// Returns point number `i` of the cloud at an address, m.
  using Read = Eigen::Vector3d (*)(const void* cloud, std::size_t i);

  /// Views the points of a cloud.
  template <
      class Cloud,
      std::enable_if_t<
          std::conjunction_v<std::negation<std::is_same<Cloud, PointView>>, detail::IsCloud<Cloud>>, int> = 0>
  PointView(const Cloud& cloud) : PointView(view_of(cloud)) {}

  /// Views the points of a buffer. \throws InputError if the buffer contradicts itself
  PointView(const PointBuffer& buffer);

  /// Views three members of the elements of a contiguous container, by pointers to members, such as the
  /// normals in a struct of your own. The members are all float or all double.
  template <class Cloud, class Point, class Scalar>
  PointView(const Cloud& cloud, Scalar Point::*x, Scalar Point::*y, Scalar Point::*z) {
    const auto* first = cloud.data();
    *this = cloud.size() == 0
                ? strided<Scalar>(nullptr, nullptr, nullptr, 0, 0)
                : strided(&(first->*x), &(first->*y), &(first->*z), cloud.size(), sizeof(*first));
  }

  /// For traits of your own: views coordinates at the distance `stride`, in bytes, from point to point.
  template <class Scalar>
  [[nodiscard]] static PointView strided(const Scalar* x, const Scalar* y, const Scalar* z, std::size_t size,
                                         std::ptrdiff_t stride) {
    static_assert(std::is_same_v<Scalar, float> || std::is_same_v<Scalar, double>,
                  "coordinates in memory are float or double; PointCloudTraits::point() converts others");
    const auto* start = reinterpret_cast<const unsigned char*>(x);
    PointView out(std::is_same_v<Scalar, float> ? Kind::kFloats : Kind::kDoubles, x, size);
    out.stride_ = stride;
    out.y_ = reinterpret_cast<const unsigned char*>(y) - start;
    out.z_ = reinterpret_cast<const unsigned char*>(z) - start;
    return out;
  }

  /// For traits of your own: views the points that a function returns.
  [[nodiscard]] static PointView by_function(const void* cloud, std::size_t size, Read read) {
    PointView out(Kind::kFunction, cloud, size);
    out.read_ = read;
    return out;
  }

  /// For traits of your own: views an array, which algorithms read fastest.
  [[nodiscard]] static PointView by_array(const Eigen::Vector3f* points, std::size_t size) {
    return PointView(Kind::kArray, points, size);
  }

  /// Number of points.
  [[nodiscard]] std::size_t size() const { return size_; }
  /// Whether there is no point.
  [[nodiscard]] bool empty() const { return size_ == 0; }

  /// Point number `i`, m.
  [[nodiscard]] Eigen::Vector3d operator[](std::size_t i) const {
    switch (kind_) {
      case Kind::kArray:
        return array()[i].cast<double>();
      case Kind::kFloats:
        return read<float>(i);
      case Kind::kDoubles:
        return read<double>(i);
      case Kind::kFunction:
        break;
    }
    return read_(data_, i);
  }

  /// The points as an array; null if they are not a contiguous array of Eigen::Vector3f.
  [[nodiscard]] const Eigen::Vector3f* array() const {
    return kind_ == Kind::kArray ? static_cast<const Eigen::Vector3f*>(data_) : nullptr;
  }

  /// Whether all coordinates are floats in memory, so that reading them in single precision loses no digits.
  [[nodiscard]] bool is_single() const { return kind_ == Kind::kArray || kind_ == Kind::kFloats; }

 private:
  enum class Kind { kArray, kFloats, kDoubles, kFunction };

  PointView(Kind kind, const void* data, std::size_t size) : kind_(kind), data_(data), size_(size) {}

  template <class Cloud>
  static PointView view_of(const Cloud& cloud) {
    using Traits = PointCloudTraits<Cloud>;
    if constexpr (detail::HasView<Cloud>::value) {
      return Traits::view(cloud);
    } else {
      return by_function(std::addressof(cloud), Traits::size(cloud), [](const void* c, std::size_t i) {
        return Eigen::Vector3d(Traits::point(*static_cast<const Cloud*>(c), i));
      });
    }
  }

  /// By memcpy, because the bytes of a buffer need not be aligned.
  template <class Scalar>
  [[nodiscard]] Eigen::Vector3d read(std::size_t i) const {
    const unsigned char* x =
        static_cast<const unsigned char*>(data_) + static_cast<std::ptrdiff_t>(i) * stride_;
    const auto at = [](const unsigned char* bytes) {
      Scalar value;
      std::memcpy(&value, bytes, sizeof value);
      return static_cast<double>(value);
    };
    return {at(x), at(x + y_), at(x + z_)};
  }

  Kind kind_ = Kind::kArray;
  const void* data_ = nullptr;  // x of the first point, or the argument of read_
  std::size_t size_ = 0;
  std::ptrdiff_t stride_ = 0;     // bytes
  std::ptrdiff_t y_ = 0, z_ = 0;  // from x, bytes
  Read read_ = nullptr;
};

/// How a cloud is read, see PointView. For a type of your own, specialise it with size() and point(). If its
/// points are at a fixed distance in memory, a function view() that returns PointView::strided() spares a
/// call for each point; if it has normals, a function normals() returns their view.
template <class Cloud, class>
struct PointCloudTraits {
  /// Whether a type without a specialisation has the members of a container of points.
  static constexpr bool kReadable = detail::HasPoints<Cloud>::value;

  /// Number of points.
  [[nodiscard]] static std::size_t size(const Cloud& cloud) { return static_cast<std::size_t>(cloud.size()); }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const Cloud& cloud, std::size_t i) {
    return detail::vector_of<detail::AsPoint>(cloud[static_cast<decltype(cloud.size())>(i)]);
  }
  /// All points.
  [[nodiscard]] static PointView view(const Cloud& cloud) { return view_as<detail::AsPoint>(cloud); }
  /// The normals of all points, if elements have normal_x, normal_y, normal_z.
  template <class Same = Cloud, std::enable_if_t<detail::HasNormals<Same>::value, int> = 0>
  [[nodiscard]] static PointView normals(const Same& cloud) {
    return view_as<detail::AsNormal>(cloud);
  }

 private:
  template <class Way>
  static PointView view_as(const Cloud& cloud) {
    using Element = detail::ElementOf<Cloud>;
    using Coordinates = decltype(detail::coordinates(std::declval<const Element&>(), Way()));
    using Scalar = typename detail::ScalarInMemory<Coordinates>::type;
    if constexpr (detail::IsContiguous<Cloud>::value && std::is_same_v<Element, Eigen::Vector3f>) {
      return PointView::by_array(cloud.data(), size(cloud));
    } else if constexpr (detail::IsContiguous<Cloud>::value && !std::is_void_v<Scalar>) {
      if (size(cloud) == 0) return PointView::strided<Scalar>(nullptr, nullptr, nullptr, 0, 0);
      const Element& first = *cloud.data();
      const auto [x, y, z] = detail::coordinates(first, Way());
      // A number that an element refers to, as a vector of vectors does, has no fixed distance to the next.
      if (holds(first, x) && holds(first, y) && holds(first, z)) {
        return PointView::strided(&x, &y, &z, size(cloud), sizeof(Element));
      }
    }
    return PointView::by_function(std::addressof(cloud), size(cloud), [](const void* address, std::size_t i) {
      const auto& c = *static_cast<const Cloud*>(address);
      return detail::vector_of<Way>(c[static_cast<decltype(c.size())>(i)]);
    });
  }

  template <class Element, class Scalar>
  static bool holds(const Element& element, const Scalar& number) {
    const auto begin = reinterpret_cast<std::uintptr_t>(std::addressof(element));
    const auto at = reinterpret_cast<std::uintptr_t>(&number);
    return at >= begin && at + sizeof(Scalar) <= begin + sizeof(Element);
  }
};

/// Eigen matrices with one point per column.
template <class Matrix>
struct PointCloudTraits<Matrix, std::enable_if_t<std::is_base_of_v<Eigen::MatrixBase<Matrix>, Matrix>>> {
  static_assert(Matrix::RowsAtCompileTime == 3 || Matrix::RowsAtCompileTime == Eigen::Dynamic,
                "a matrix of points has three rows, one column for each point");
  /// Number of points. \throws InputError unless the matrix has three rows.
  [[nodiscard]] static std::size_t size(const Matrix& matrix) {
    if (matrix.rows() != 3) {
      throw InputError("a matrix of points has 3 rows, one column for each point; found " +
                       std::to_string(matrix.rows()) + " rows: pass its transpose if points are rows");
    }
    return static_cast<std::size_t>(matrix.cols());
  }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const Matrix& matrix, std::size_t i) {
    return matrix.col(static_cast<Eigen::Index>(i)).template cast<double>();
  }
  /// All points.
  [[nodiscard]] static PointView view(const Matrix& matrix) {
    using Scalar = typename Matrix::Scalar;
    constexpr bool kInMemory = (Matrix::Flags & Eigen::DirectAccessBit) != 0 &&
                               (std::is_same_v<Scalar, float> || std::is_same_v<Scalar, double>);
    if constexpr (kInMemory) {
      const std::size_t count = size(matrix);
      const Scalar* x = matrix.derived().data();
      const Eigen::Index row = matrix.rowStride();
      constexpr auto kBytes = static_cast<std::ptrdiff_t>(sizeof(Scalar));
      return count == 0 ? PointView::strided<Scalar>(nullptr, nullptr, nullptr, 0, 0)
                        : PointView::strided(x, x + row, x + 2 * row, count, matrix.colStride() * kBytes);
    } else {
      return PointView::by_function(std::addressof(matrix), size(matrix), [](const void* m, std::size_t i) {
        return point(*static_cast<const Matrix*>(m), i);
      });
    }
  }
};

/// The cloud of the library. Intensities are not used.
template <>
struct PointCloudTraits<PointCloud> {
  /// Number of points.
  [[nodiscard]] static std::size_t size(const PointCloud& cloud) { return cloud.size(); }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const PointCloud& cloud, std::size_t i) {
    return cloud.origin + cloud.points[i].cast<double>();
  }
  /// All points.
  [[nodiscard]] static PointView view(const PointCloud& cloud) {
    if (cloud.origin.isZero(0.0)) return cloud.points;
    return PointView::by_function(&cloud, cloud.size(), [](const void* c, std::size_t i) {
      return point(*static_cast<const PointCloud*>(c), i);
    });
  }
  /// The normals of all points; empty if the cloud has no normals.
  [[nodiscard]] static PointView normals(const PointCloud& cloud) { return cloud.normals; }
};

namespace detail {

/// The buffer of a message for the fields with these names. \throws InputError naming the field or the member
/// of the message that cannot be read
template <class Message>
[[nodiscard]] PointBuffer buffer_of(const Message& message, const std::array<const char*, 3>& names) {
  PointBuffer buffer;
  buffer.data = message.data.data();
  buffer.bytes = message.data.size();
  buffer.points = std::size_t{message.width} * message.height;
  buffer.stride = message.point_step;
  const auto fail = [](const std::string& why) { throw InputError("PointCloud2: " + why); };
  if (message.is_bigendian) fail("is_bigendian is set: swap the bytes before");
  const std::size_t row = std::size_t{message.point_step} * message.width;
  if (message.height > 1 && message.row_step != row) {
    fail("row_step = " + std::to_string(message.row_step) +
         ", must be point_step · width = " + std::to_string(row) + ": copy the rows without their padding");
  }
  for (std::size_t axis = 0; axis < names.size(); ++axis) {
    const std::string name = names[axis];
    bool found = false;
    for (const auto& field : message.fields) {
      if (name != field.name) continue;
      found = true;
      constexpr int kFloat32 = 7, kFloat64 = 8;
      const int type = static_cast<int>(field.datatype);
      if (type != kFloat32 && type != kFloat64) fail("field " + name + " is neither FLOAT32 nor FLOAT64");
      const CoordinateType wanted = type == kFloat32 ? CoordinateType::kFloat : CoordinateType::kDouble;
      if (axis > 0 && wanted != buffer.type) fail("field " + name + " has another type than " + names[0]);
      buffer.type = wanted;
      buffer.offsets[axis] = field.offset;
    }
    if (!found) fail("there is no field " + name);
  }
  return buffer;
}

}  // namespace detail

/// Messages sensor_msgs/PointCloud2 of ROS 1 and ROS 2, and pcl::PCLPointCloud2: fields x, y, z and, for
/// normals, normal_x, normal_y, normal_z. Loopwise needs no header of ROS for it.
template <class Message>
struct PointCloudTraits<Message, std::enable_if_t<detail::IsMessage<Message>::value>> {
  /// Number of points.
  [[nodiscard]] static std::size_t size(const Message& message) { return view(message).size(); }
  /// Point number `i`, m.
  [[nodiscard]] static Eigen::Vector3d point(const Message& message, std::size_t i) {
    return view(message)[i];
  }
  /// All points. \throws InputError naming the field or the member that cannot be read
  [[nodiscard]] static PointView view(const Message& message) {
    return detail::buffer_of(message, {"x", "y", "z"});
  }
  /// The normals of all points. \throws InputError as view()
  [[nodiscard]] static PointView normals(const Message& message) {
    return detail::buffer_of(message, {"normal_x", "normal_y", "normal_z"});
  }
};

/// Points with their surface normals, in the memory of their owners. Clouds that hold both convert to it:
/// PointCloud with normals, containers of elements with x, y, z and normal_x, normal_y, normal_z
/// (pcl::PointNormal), messages with these fields. Normals have unit length and face the sensor. A normal
/// that is zero or not finite means "unknown".
class LOOPWISE_EXPORT PointNormalView {
 public:
  /// \throws InputError unless there are as many normals as points
  PointNormalView(PointView points, PointView normals);

  /// Views the points and normals of a cloud. \throws InputError unless each point has a normal
  template <class Cloud,
            std::enable_if_t<std::conjunction_v<std::negation<std::is_same<Cloud, PointNormalView>>,
                                                detail::HasNormalView<Cloud>>,
                             int> = 0>
  PointNormalView(const Cloud& cloud)
      : PointNormalView(PointView(cloud), PointCloudTraits<Cloud>::normals(cloud)) {}

  /// The points.
  [[nodiscard]] PointView points() const { return points_; }
  /// One normal for each point.
  [[nodiscard]] PointView normals() const { return normals_; }
  /// Number of points.
  [[nodiscard]] std::size_t size() const { return points_.size(); }

 private:
  PointView points_, normals_;
};

namespace detail {

/// Points in single precision, as algorithms compute with them.
struct SinglePoints {
  PointView points;  ///< Of any type.
  [[nodiscard]] Eigen::Vector3f operator[](std::size_t i) const { return points[i].cast<float>(); }
};

/// Calls an algorithm with an object whose operator[] gives points as Eigen::Vector3f: the array itself, if
/// there is one, so that it costs nothing; otherwise SinglePoints.
template <class Algorithm>
decltype(auto) with_points(PointView points, Algorithm&& algorithm) {
  if (points.array() != nullptr) return std::forward<Algorithm>(algorithm)(points.array());
  return std::forward<Algorithm>(algorithm)(SinglePoints{points});
}

/// \throws InputError if reading the points in single precision would lose digits: most of them are more than
/// 16 km from zero along an axis, in double precision. `what` begins the message
LOOPWISE_EXPORT void check_precision(PointView points, const char* what);

}  // namespace detail

}  // namespace loopwise
