// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <mutex>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/keyed_scan.hpp>

namespace loopwise {

/// Records the nodes and scans that producers have added, and stores the clouds. Thread-safe.
class Intake {
 public:
  /// Stores clouds only if `scans` is empty.
  explicit Intake(ScanLoader scans) : scans_(std::move(scans)) {}

  /// \throws InputError if the node or its scan was added before; nothing is stored then
  void add_node(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (nodes_.count(key) != 0) throw InputError("node " + key_name(key) + " was added before");
    if (cloud) keep(key, cloud);
    nodes_.insert(key);
  }
  /// \throws InputError if the node already has a scan
  void add_scan(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    const std::lock_guard<std::mutex> lock(mutex_);
    keep(key, cloud);
  }

  /// The cloud of a node; null if it has not arrived.
  [[nodiscard]] std::shared_ptr<const PointCloud> load(Key key) const {
    if (scans_) return scans_(key);
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = clouds_.find(key);
    return found == clouds_.end() ? nullptr : found->second;
  }

  /// \throws InputError if a point is not finite
  static void check_cloud(Key key, const PointCloud& cloud) {
    for (const Eigen::Vector3f& p : cloud.points) {
      if (!p.allFinite()) throw InputError("scan of node " + key_name(key) + ": a point is not finite");
    }
  }

 private:
  void keep(Key key, const std::shared_ptr<const PointCloud>& cloud) {
    if (scans_seen_.count(key) != 0) throw InputError("node " + key_name(key) + " has a scan already");
    if (!scans_) clouds_.emplace(key, cloud);
    scans_seen_.insert(key);
  }

  const ScanLoader scans_;
  mutable std::mutex mutex_;
  std::unordered_set<Key> nodes_, scans_seen_;
  std::unordered_map<Key, std::shared_ptr<const PointCloud>> clouds_;
};

}  // namespace loopwise
