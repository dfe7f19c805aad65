// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/features/kd_tree.hpp>

#include <algorithm>
#include <array>
#include <cstring>
#include <string>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

constexpr std::size_t kMaxLeaf = 12;

/// Keeps the nearest point within a bound.
class NearestVisitor {
 public:
  explicit NearestVisitor(float sq_bound) { best_.sq_distance_m2 = sq_bound; }
  [[nodiscard]] float bound() const { return best_.sq_distance_m2; }
  void offer(const float* sq_distances, const std::uint32_t* indices, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i) {
      if (sq_distances[i] <= bound()) take(sq_distances[i], indices[i]);
    }
  }
  [[nodiscard]] std::optional<Neighbour> result() const {
    return found_ ? std::optional<Neighbour>(best_) : std::nullopt;
  }

 private:
  void take(float sq_distance, std::uint32_t index) {
    if (sq_distance == best_.sq_distance_m2 && (!found_ || index > best_.index)) return;
    best_ = {index, sq_distance};
    found_ = true;
  }

  Neighbour best_;
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
  void offer(const float* sq_distances, const std::uint32_t* indices, std::size_t size) {
    std::array<double, kMaxLeaf> near;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < size; ++i) {
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
  float bound_ = std::numeric_limits<float>::infinity();
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
  void offer(const float* sq_distances, const std::uint32_t* indices, std::size_t size) {
    for (std::size_t i = 0; i < size; ++i) {
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

template <class Points>
void KdTree::build(const Points& points) {
  original_.reserve(cloud_size_);
  for (std::uint32_t i = 0; i < cloud_size_; ++i) {
    if (points[i].allFinite()) original_.push_back(i);
  }
  size_ = original_.size();
  if (size_ == 0) return;
  while (((size_ - 1) >> depth_) + 1 > kMaxLeaf) ++depth_;
  const std::size_t leaves = std::size_t{1} << depth_;
  splits_.resize(leaves - 1);
  leaf_begin_.resize(leaves + 1);

  struct Task {
    std::size_t node, begin, end;
  };
  std::vector<Task> tasks{{0, 0, size_}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    if (task.node >= leaves - 1) {
      leaf_begin_[task.node - (leaves - 1)] = static_cast<std::uint32_t>(task.begin);
      continue;
    }
    Eigen::Array3f low = Eigen::Array3f::Constant(std::numeric_limits<float>::infinity());
    Eigen::Array3f high = -low;
    for (std::size_t i = task.begin; i < task.end; ++i) {
      low = low.min(points[original_[i]].array());
      high = high.max(points[original_[i]].array());
    }
    Eigen::Index axis = 0;
    (high - low).maxCoeff(&axis);
    const auto begin = original_.begin() + static_cast<std::ptrdiff_t>(task.begin);
    const auto end = original_.begin() + static_cast<std::ptrdiff_t>(task.end);
    const auto middle = begin + (end - begin) / 2;
    std::nth_element(begin, middle, end, [&](std::uint32_t a, std::uint32_t b) {
      const float xa = points[a][axis], xb = points[b][axis];
      return xa != xb ? xa < xb : a < b;
    });
    Split& split = splits_[task.node];
    split.axis = static_cast<std::uint32_t>(axis);
    split.high = points[*middle][axis];
    split.low = -std::numeric_limits<float>::infinity();
    for (auto i = begin; i != middle; ++i) split.low = std::max(split.low, points[*i][axis]);
    const auto cut = static_cast<std::size_t>(middle - original_.begin());
    tasks.push_back({2 * task.node + 1, task.begin, cut});
    tasks.push_back({2 * task.node + 2, cut, task.end});
  }
  leaf_begin_[leaves] = static_cast<std::uint32_t>(size_);

  x_.resize(size_);
  y_.resize(size_);
  z_.resize(size_);
  for (std::size_t i = 0; i < size_; ++i) {
    const Eigen::Vector3f p = points[original_[i]];
    x_[i] = p.x();
    y_[i] = p.y();
    z_[i] = p.z();
  }
}

template <class Visitor>
void KdTree::search(const Eigen::Vector3f& query, Visitor& visitor) const {
  if (size_ == 0 || !query.allFinite()) return;
  // Offsets from the query to a node's cell, by axis. They are squared and added exactly as distances of
  // points are, so that rounding never makes a cell appear farther away than a point in it.
  struct Pending {
    std::size_t node;
    float sq_distance;
    std::array<float, 3> offset;
  };
  std::array<Pending, 64> stack;
  std::size_t height = 0;
  stack[height++] = {0, 0.0F, {0.0F, 0.0F, 0.0F}};
  const std::size_t inner = splits_.size();
  const float qx = query.x(), qy = query.y(), qz = query.z();
  std::array<float, kMaxLeaf> sq_distances;
  while (height > 0) {
    const Pending top = stack[--height];
    if (top.sq_distance > visitor.bound()) continue;
    std::size_t node = top.node;
    while (node < inner) {
      const Split& split = splits_[node];
      const float q = query[static_cast<Eigen::Index>(split.axis)];
      const float to_low = q - split.low, to_high = split.high - q;
      const bool lower = to_low < to_high;
      const float offset = std::max(0.0F, lower ? to_high : to_low);
      Pending far{2 * node + (lower ? 2U : 1U), 0.0F, top.offset};
      // A cell's offset along an axis only grows on the way down.
      far.offset[split.axis] = std::max(far.offset[split.axis], offset);
      far.sq_distance =
          far.offset[0] * far.offset[0] + far.offset[1] * far.offset[1] + far.offset[2] * far.offset[2];
      if (far.sq_distance <= visitor.bound()) stack[height++] = far;
      node = 2 * node + (lower ? 1U : 2U);
    }
    const std::size_t begin = leaf_begin_[node - inner], count = leaf_begin_[node - inner + 1] - begin;
    const float* x = x_.data() + begin;
    const float* y = y_.data() + begin;
    const float* z = z_.data() + begin;
    for (std::size_t i = 0; i < count; ++i) {
      const float dx = x[i] - qx, dy = y[i] - qy, dz = z[i] - qz;
      sq_distances[i] = dx * dx + dy * dy + dz * dz;
    }
    visitor.offer(sq_distances.data(), original_.data() + begin, count);
  }
}

std::optional<Neighbour> KdTree::nearest(const Eigen::Vector3f& query, float max_distance_m) const {
  NearestVisitor visitor(max_distance_m * max_distance_m);
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
  RadiusVisitor visitor(radius_m * radius_m, found);
  search(query, visitor);
}

std::size_t KdTree::bytes() const {
  return sizeof(*this) + splits_.capacity() * sizeof(Split) + leaf_begin_.capacity() * sizeof(std::uint32_t) +
         3 * x_.capacity() * sizeof(float) + original_.capacity() * sizeof(std::uint32_t);
}

}  // namespace loopwise
