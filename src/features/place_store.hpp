// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/features/place.hpp>

namespace loopwise {

/// The places of a database, by key and by number. Numbers follow the order in which places were added.
template <class Descriptor>
class PlaceStore {
 public:
  /// The descriptor as `Descriptor`. \throws InputError if it is of another kind
  [[nodiscard]] static const Descriptor& own(const PlaceDescriptor& place, std::string_view database) {
    const auto* mine = dynamic_cast<const Descriptor*>(&place);
    if (mine == nullptr) {
      throw InputError("the place was described by another kind of database than " + std::string(database));
    }
    return *mine;
  }

  /// \returns the number of the place. \throws InputError if the key is already present
  std::size_t add(Key key, std::shared_ptr<const PlaceDescriptor> place, std::string_view database) {
    if (!place) throw InputError("place " + key_name(key) + " has no descriptor");
    static_cast<void>(own(*place, database));
    if (!number_of_.emplace(key, keys_.size()).second) {
      throw InputError("place " + key_name(key) + " was added before");
    }
    keys_.push_back(key);
    places_.push_back(std::move(place));
    return keys_.size() - 1;
  }

  [[nodiscard]] std::shared_ptr<const PlaceDescriptor> find(Key key) const {
    const auto found = number_of_.find(key);
    return found == number_of_.end() ? nullptr : places_[found->second];
  }
  [[nodiscard]] std::size_t size() const { return keys_.size(); }
  [[nodiscard]] Key key(std::size_t number) const { return keys_[number]; }
  [[nodiscard]] const Descriptor& operator[](std::size_t number) const {
    return *static_cast<const Descriptor*>(places_[number].get());
  }

 private:
  std::vector<Key> keys_;
  std::vector<std::shared_ptr<const PlaceDescriptor>> places_;
  std::unordered_map<Key, std::size_t> number_of_;
};

/// Keeps the `k` best matches, best first, equal ones by key.
inline void keep_best(std::vector<PlaceMatch>& matches, std::size_t k) {
  std::sort(matches.begin(), matches.end(), [](const PlaceMatch& a, const PlaceMatch& b) {
    return a.similarity != b.similarity ? a.similarity > b.similarity : a.key < b.key;
  });
  if (matches.size() > k) matches.resize(k);
}

/// Covariance of a pose between level frames, from the standard deviations of each horizontal axis, the
/// height, the tilt and the yaw.
inline Matrix6d level_covariance(double horizontal_m, double height_m, double tilt_rad, double yaw_rad) {
  Vector6d sigma;
  sigma << horizontal_m, horizontal_m, height_m, tilt_rad, tilt_rad, yaw_rad;
  return sigma.cwiseAbs2().asDiagonal();
}

inline constexpr double kTiltSigma_rad = 0.05;  ///< Error of odometry's vertical between two places.
inline constexpr double kHeightSigma_m = 1.0;   ///< Error of a sensor's height above the ground.

}  // namespace loopwise
