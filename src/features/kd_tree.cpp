// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/kd_tree.hpp>

#include <algorithm>
#include <array>
#include <cstring>
#include <string>
#include <utility>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kLeaf = 8;  // points of a leaf at most
// Free places of leaves and nodes are at infinity, which is above every bound of a squared distance.
constexpr float kFree = std::numeric_limits<float>::infinity();
constexpr float kLargestBound = std::numeric_limits<float>::max();

float squared_bound(float distance_m) {
  return std::min(distance_m * distance_m, kLargestBound);
}

/// Eight numbers, with SIMD where there is any.
using Lanes = Eigen::Array<float, kLeaf, 1>;
Eigen::Map<const Lanes> lanes(const float* from) {
  return Eigen::Map<const Lanes>(from);
}

/// The smallest index of the points at this distance.
std::uint32_t index_at(float sq_distance, const Lanes& sq_distances, const std::uint32_t* indices) {
  std::uint32_t index = ~std::uint32_t{0};
  for (std::size_t i = 0; i < kLeaf; ++i) {
    const std::uint32_t at = sq_distances[i] == sq_distance ? indices[i] : ~std::uint32_t{0};
    index = std::min(index, at);
  }
  return index;
}

/// Keeps the nearest point within a bound.
class NearestVisitor {
 public:
  explicit NearestVisitor(float sq_bound) { best_.sq_distance_m2 = sq_bound; }
  [[nodiscard]] float bound() const { return best_.sq_distance_m2; }
  void offer(const Lanes& sq_distances, const std::uint32_t* indices) {
    const float least = sq_distances.minCoeff();
    if (!(least <= bound())) return;
    const std::uint32_t index = index_at(least, sq_distances, indices);
    best_.index = found_ && least == bound() ? std::min(index, best_.index) : index;
    best_.sq_distance_m2 = least;
    found_ = true;
  }
  [[nodiscard]] std::optional<Neighbour> result() const {
    return found_ ? std::optional<Neighbour>(best_) : std::nullopt;
  }

 private:
  Neighbour best_;
  bool found_ = false;
};

/// Keeps the nearest point and the distance of the second nearest within a bound.
class NearestOfTwoVisitor {
 public:
  explicit NearestOfTwoVisitor(float sq_bound) : sq_nearest_(sq_bound), sq_second_(sq_bound) {}
  [[nodiscard]] float bound() const { return sq_second_; }
  void offer(const Lanes& sq_distances, const std::uint32_t* indices) {
    const float least = sq_distances.minCoeff();
    if (!(least <= sq_second_)) return;
    const std::uint32_t index = index_at(least, sq_distances, indices);
    Lanes others = sq_distances;
    for (std::size_t i = 0; i < kLeaf; ++i) {
      if (indices[i] == index) others[static_cast<Eigen::Index>(i)] = kLargestBound;
    }
    const float second = others.minCoeff();
    if (!found_ || least < sq_nearest_) {
      sq_second_ = std::min(found_ ? sq_nearest_ : sq_second_, second);
      index_ = index;
      sq_nearest_ = least;
    } else {
      sq_second_ = least;
      if (least == sq_nearest_) index_ = std::min(index_, index);
    }
    found_ = true;
  }
  [[nodiscard]] std::optional<NearestOfTwo> result() const {
    if (!found_) return std::nullopt;
    return NearestOfTwo{{index_, sq_nearest_}, sq_second_};
  }

 private:
  float sq_nearest_, sq_second_;
  std::uint32_t index_ = 0;
  bool found_ = false;
};

bool nearer(const Neighbour& a, const Neighbour& b) {
  return a.sq_distance_m2 != b.sq_distance_m2 ? a.sq_distance_m2 < b.sq_distance_m2 : a.index < b.index;
}

/// A point and its squared distance as one positive number, in the order of nearer(): the bits of floats that
/// are not negative are in the order of their values, and an index has 31 bits. Bit 62 keeps the number out
/// of the denormal ones, which a host may flush to zero. An infinite distance still gives a finite number.
double packed(float sq_distance, std::uint32_t index) {
  std::uint32_t bits;
  std::memcpy(&bits, &sq_distance, sizeof bits);
  const std::uint64_t number = (std::uint64_t{1} << 62U) | (std::uint64_t{bits} << 31U) | index;
  double out;
  std::memcpy(&out, &number, sizeof out);
  return out;
}

Neighbour unpacked(double point) {
  std::uint64_t number;
  std::memcpy(&number, &point, sizeof number);
  const auto bits = static_cast<std::uint32_t>(number >> 31U) & 0x7fffffffU;
  Neighbour out{static_cast<std::uint32_t>(number) & 0x7fffffffU, 0.0F};
  std::memcpy(&out.sq_distance_m2, &bits, sizeof bits);
  return out;
}

/// Keeps the `count` nearest points in order. The search costs most for mispredicted branches, so there are
/// few.
class CountVisitor {
 public:
  explicit CountVisitor(std::size_t count) : count_(count) {
    if (count >= few_[0].size()) {
      many_.resize(2 * (count + 1));
      now_ = many_.data();
      next_ = now_ + count + 1;
    }
    for (double* points : {now_, next_}) {
      std::fill_n(points, count + 1, kNone);
      points[0] = 0.0;
    }
  }
  [[nodiscard]] float bound() const { return bound_; }
  void offer(const Lanes& sq_distances, const std::uint32_t* indices) {
    std::array<double, kLeaf> near;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < kLeaf; ++i) {
      near[inside] = packed(sq_distances[i], indices[i]);
      inside += sq_distances[i] <= bound_ ? 1 : 0;
    }
    if (inside == 0) return;
    for (std::size_t i = 0; i < inside; ++i) insert(near[i]);
    if (now_[count_] != kNone) bound_ = unpacked(now_[count_]).sq_distance_m2;
  }
  void result(std::vector<Neighbour>& found) const {
    for (std::size_t i = 1; i <= kept_; ++i) found.push_back(unpacked(now_[i]));
  }

 private:
  static constexpr double kNone = std::numeric_limits<double>::infinity();

  /// The points before the new one keep their places, those behind it move by one; without a branch, each
  /// place gets the smaller of its point and the larger of the new point and the one before.
  void insert(double point) {
    kept_ = std::min(kept_ + 1, count_);
    const double* __restrict now = now_;
    double* __restrict next = next_;
    for (std::size_t i = 1; i <= kept_; ++i) {
      const double before = now[i - 1], at = now[i];
      const double moved = before > point ? before : point;
      next[i] = at < moved ? at : moved;
    }
    std::swap(now_, next_);
  }

  std::size_t count_, kept_ = 0;
  float bound_ = kLargestBound;
  // Sorted behind a first number that is below all, with kNone in places that are free. Each insertion writes
  // from one buffer to the other, so that the loop has no dependences.
  std::array<std::array<double, 32>, 2> few_;
  std::vector<double> many_;
  double* now_ = few_[0].data();
  double* next_ = few_[1].data();
};

class RadiusVisitor {
 public:
  RadiusVisitor(float sq_radius, std::vector<Neighbour>& found) : sq_radius_(sq_radius), found_(found) {}
  [[nodiscard]] float bound() const { return sq_radius_; }
  void offer(const Lanes& sq_distances, const std::uint32_t* indices) {
    for (std::size_t i = 0; i < kLeaf; ++i) {
      if (sq_distances[i] <= sq_radius_) found_.push_back({indices[i], sq_distances[i]});
    }
  }

 private:
  float sq_radius_;
  std::vector<Neighbour>& found_;
};

}  // namespace

KdTree::KdTree(PointView points) : cloud_size_(points.size()) {
  if (cloud_size_ >= (std::size_t{1} << 31)) {
    throw InputError("a kd-tree holds less than 2^31 points, got " + std::to_string(cloud_size_));
  }
  detail::check_precision(points, "KdTree: the cloud");
  detail::with_points(points, [this](const auto& array) { build(array); });
}

/// A point on its way to its leaf.
struct KdTree::Item {
  std::array<float, 3> at;
  std::uint32_t index;
};

namespace {

/// The axis along which points extend the most, the first of equal ones.
template <class Item>
std::size_t longest_axis(const Item* begin, const Item* end) {
  std::array<float, 3> low = begin->at, high = low;
  for (const Item* item = begin; item != end; ++item) {
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], item->at[k]);
      high[k] = std::max(high[k], item->at[k]);
    }
  }
  std::size_t axis = 0;
  for (std::size_t k = 1; k < 3; ++k) {
    if (high[k] - low[k] > high[axis] - low[axis]) axis = k;
  }
  return axis;
}

}  // namespace

template <class Points>
void KdTree::build(const Points& points) {
  std::vector<Item> items;
  items.reserve(cloud_size_);
  for (std::uint32_t i = 0; i < cloud_size_; ++i) {
    const Eigen::Vector3f p = points[i];
    if (p.allFinite()) items.push_back({{p.x(), p.y(), p.z()}, i});
  }
  size_ = items.size();
  if (size_ == 0) return;
  int depth = 0;  // levels of binary splits
  while (((size_ - 1) >> depth) + 1 > kWidth) ++depth;
  const std::size_t leaves = std::size_t{1} << depth;
  for (std::vector<float>* coordinates : {&x_, &y_, &z_}) coordinates->assign(kWidth * leaves, kFree);
  original_.assign(kWidth * leaves, ~std::uint32_t{0});

  struct Task {
    std::size_t node;  // in heap order
    Item *begin, *end;
  };
  std::vector<Task> tasks{{0, items.data(), items.data() + size_}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    if (task.node >= leaves - 1) {
      add_leaf(task.node - (leaves - 1), task.begin, task.end);
      continue;
    }
    const std::size_t axis = longest_axis(task.begin, task.end);
    Item* middle = task.begin + (task.end - task.begin) / 2;
    std::nth_element(task.begin, middle, task.end, [axis](const Item& a, const Item& b) {
      return a.at[axis] != b.at[axis] ? a.at[axis] < b.at[axis] : a.index < b.index;
    });
    tasks.push_back({2 * task.node + 1, task.begin, middle});
    tasks.push_back({2 * task.node + 2, middle, task.end});
  }
  if (depth > 0) {
    const auto of_root = static_cast<std::ptrdiff_t>(std::size_t{1} << ((depth - 1) % 3 + 1));
    first_child_ = of_root - static_cast<std::ptrdiff_t>(kWidth) + 1;
    bound_nodes(leaves);
  }
}

void KdTree::add_leaf(std::size_t leaf, const Item* begin, const Item* end) {
  std::size_t place = kWidth * leaf;
  for (const Item* item = begin; item != end; ++item, ++place) {
    x_[place] = item->at[0];
    y_[place] = item->at[1];
    z_[place] = item->at[2];
    original_[place] = item->index;
  }
}

/// Makes the nodes above the leaves, last ones first.
void KdTree::bound_nodes(std::size_t leaves) {
  std::size_t count = 0;
  for (std::size_t level = leaves; level > 1; count += level) level = (level + kWidth - 1) / kWidth;
  nodes_.resize(count);
  for (std::size_t k = count; k-- > 0;) {
    for (std::size_t i = 0; i < kWidth; ++i) {
      const std::ptrdiff_t child = first_child_ + static_cast<std::ptrdiff_t>(kWidth * k + i);
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const auto [low, high] =
            child < 1 ? std::pair(kFree, -kFree) : extent(static_cast<std::size_t>(child), axis);
        nodes_[k].low[axis][i] = low;
        nodes_[k].high[axis][i] = high;
      }
    }
  }
}

/// Smallest and largest coordinate of a node or leaf, which has a point.
std::pair<float, float> KdTree::extent(std::size_t child, std::size_t axis) const {
  float low = kFree, high = -kFree;
  for (std::size_t i = 0; i < kWidth; ++i) {
    if (child < nodes_.size()) {
      low = std::min(low, nodes_[child].low[axis][i]);
      high = std::max(high, nodes_[child].high[axis][i]);
    } else {
      const float at = (axis == 0 ? x_ : axis == 1 ? y_ : z_)[kWidth * (child - nodes_.size()) + i];
      if (at == kFree) continue;  // a free place
      low = std::min(low, at);
      high = std::max(high, at);
    }
  }
  return {low, high};
}

template <class Visitor>
void KdTree::search(const Eigen::Vector3f& query, Visitor& visitor) const {
  if (size_ == 0 || !query.allFinite()) return;
  struct Pending {
    float sq_distance;
    std::uint32_t child;
  };
  std::array<Pending, 96> stack;  // at most seven more on each of eleven levels
  std::size_t height = 0;
  stack[height++] = {0.0F, 0};
  const float qx = query.x(), qy = query.y(), qz = query.z();
  Lanes sq_distances;
  while (height > 0) {
    const Pending top = stack[--height];
    if (top.sq_distance > visitor.bound()) continue;
    if (top.child >= nodes_.size()) {
      const std::size_t begin = kWidth * (top.child - nodes_.size());
      const float *x = x_.data() + begin, *y = y_.data() + begin, *z = z_.data() + begin;
      sq_distances = (lanes(x) - qx).square() + (lanes(y) - qy).square() + (lanes(z) - qz).square();
      visitor.offer(sq_distances, original_.data() + begin);
      continue;
    }
    // Distances to boxes are squared and added exactly as those to points, so that rounding never makes a box
    // appear farther away than a point in it.
    const Node& node = nodes_[top.child];
    const auto squared = [&](std::size_t axis, float q) {
      return (lanes(node.low[axis]) - q).max(q - lanes(node.high[axis])).max(0.0F).square();
    };
    sq_distances = squared(0, qx) + squared(1, qy) + squared(2, qz);
    const auto first =
        static_cast<std::uint32_t>(first_child_ + static_cast<std::ptrdiff_t>(kWidth) * top.child);
    const float bound = visitor.bound();
    const std::size_t begin = height;
    for (std::uint32_t i = 0; i < kWidth; ++i) {
      stack[height] = {sq_distances[i], first + i};
      height += sq_distances[i] <= bound ? 1 : 0;
    }
    if (height - begin > 1) {  // the nearest child comes first
      std::size_t nearest = begin;
      for (std::size_t i = begin + 1; i < height; ++i) {
        if (stack[i].sq_distance < stack[nearest].sq_distance) nearest = i;
      }
      std::swap(stack[nearest], stack[height - 1]);
    }
  }
}

std::optional<Neighbour> KdTree::nearest(const Eigen::Vector3f& query, float max_distance_m) const {
  NearestVisitor visitor(squared_bound(max_distance_m));
  search(query, visitor);
  return visitor.result();
}

std::optional<NearestOfTwo> KdTree::nearest_of_two(const Eigen::Vector3f& query, float max_distance_m) const {
  NearestOfTwoVisitor visitor(squared_bound(max_distance_m));
  search(query, visitor);
  return visitor.result();
}

void KdTree::nearest(const Eigen::Vector3f& query, std::size_t count, std::vector<Neighbour>& found) const {
  found.clear();
  if (count == 0 || size_ == 0) return;
  CountVisitor visitor(std::min(count, size_));
  search(query, visitor);
  visitor.result(found);
}

void KdTree::within(const Eigen::Vector3f& query, float radius_m, std::vector<Neighbour>& found) const {
  within_unordered(query, radius_m, found);
  std::sort(found.begin(), found.end(), nearer);
}

void KdTree::within_unordered(const Eigen::Vector3f& query, float radius_m,
                              std::vector<Neighbour>& found) const {
  found.clear();
  RadiusVisitor visitor(squared_bound(radius_m), found);
  search(query, visitor);
}

std::size_t KdTree::bytes() const {
  return sizeof(*this) + nodes_.capacity() * sizeof(Node) + 3 * x_.capacity() * sizeof(float) +
         original_.capacity() * sizeof(std::uint32_t);
}

}  // namespace loopwise
