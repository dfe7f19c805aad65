// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Place recognition: finds the places of a database that a scan or submap shows, and the pose in them.
///
/// Places are described in *level* frames: z points up, and the yaw is that of the body. Two level frames of
/// one place differ only by a yaw and a translation. level_rotation() is the rotation from a body frame to
/// its level frame, level_cloud() moves a cloud there, and between_bodies() brings the pose of a match back.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>

#include <loopwise/core/export.hpp>
#include <loopwise/core/key.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/se3.hpp>

namespace loopwise {

/// A place of the database that looks like the query.
struct PlaceMatch {
  Key key = 0;              ///< Of the place in the database.
  double similarity = 0.0;  ///< In [0, 1]; comparable among the matches of one kind of database.
  /// Guessed pose of the match's level frame in the level frame of the query.
  Eigen::Isometry3d T_query_match = Eigen::Isometry3d::Identity();
  /// Covariance of the guess, given that the place is the same: right perturbation, order [translation,
  /// rotation], m² and rad².
  Matrix6d covariance = Matrix6d::Identity();
};

/// A place as a database stores it. Immutable.
class LOOPWISE_EXPORT PlaceDescriptor {
 public:
  virtual ~PlaceDescriptor() = default;
  /// Memory that the descriptor holds.
  [[nodiscard]] virtual std::size_t bytes() const = 0;
};

/// Which places a query may return; empty: all.
using PlaceFilter = std::function<bool(Key)>;

/// Places by key, searched by appearance. The interface of place recognition: users derive from it to add
/// their own descriptors. The const functions are safe to call from several threads at once. Results depend
/// only on the places and the order in which they were added.
class LOOPWISE_EXPORT PlaceDatabase {
 public:
  virtual ~PlaceDatabase() = default;

  /// Short and stable, for options and tables.
  [[nodiscard]] virtual std::string_view name() const = 0;

  /// Describes a scan or submap in its level frame. A cloud without structure gives a descriptor that matches
  /// no place. Never null.
  [[nodiscard]] virtual std::shared_ptr<const PlaceDescriptor> describe(const PointCloud& level) const = 0;

  /// Adds a place. \throws InputError if the key is in the database already
  /// \param key of the place
  /// \param place result of describe() of the same kind of database
  virtual void insert(Key key, std::shared_ptr<const PlaceDescriptor> place) = 0;

  /// The most similar places, best first, equal ones by key; fewer than `k` if fewer are similar.
  /// \param place result of describe() of the same kind of database
  /// \param k bound on the number of matches
  /// \param filter which places may be returned
  [[nodiscard]] virtual std::vector<PlaceMatch> search(const PlaceDescriptor& place, std::size_t k,
                                                       const PlaceFilter& filter) const = 0;

  /// The place of a key; null if the key is unknown.
  [[nodiscard]] virtual std::shared_ptr<const PlaceDescriptor> find(Key key) const = 0;

  /// Number of places.
  [[nodiscard]] virtual std::size_t size() const = 0;

  /// Describes and adds a place. \throws InputError if the key is in the database already
  void add(Key key, const PointCloud& level) { insert(key, describe(level)); }

  /// search() of a cloud in its level frame.
  [[nodiscard]] std::vector<PlaceMatch> query(const PointCloud& level, std::size_t k,
                                              const PlaceFilter& filter = {}) const {
    return search(*describe(level), k, filter);
  }

  /// search() of a place of the database among the others. \throws UnknownKeyError without such a place
  [[nodiscard]] std::vector<PlaceMatch> query(Key key, std::size_t k, const PlaceFilter& filter = {}) const;
};

/// Rotation from the body frame to the level frame: the body's attitude in a world whose z points up, without
/// its yaw.
[[nodiscard]] LOOPWISE_EXPORT Eigen::Matrix3d level_rotation(const Eigen::Isometry3d& T_world_body);

/// The points of a cloud in the level frame. Normals are rotated too.
/// \param body the cloud in the body frame
/// \param T_world_body pose of the body in a world whose z points up
[[nodiscard]] LOOPWISE_EXPORT PointCloud level_cloud(const PointCloud& body,
                                                     const Eigen::Isometry3d& T_world_body);

/// Converts a match of level frames to one of body frames: the pose of the match's body in the query's body,
/// with its covariance.
/// \param match of level frames
/// \param query_rotation level_rotation() of the query
/// \param match_rotation level_rotation() of the match
[[nodiscard]] LOOPWISE_EXPORT PlaceMatch between_bodies(const PlaceMatch& match,
                                                        const Eigen::Matrix3d& query_rotation,
                                                        const Eigen::Matrix3d& match_rotation);

/// Scan Context (Kim, Kim 2018): highest point above the ground in cells of range and bearing around the
/// sensor. The yaw is the shift of columns with the best match. The guessed translation is zero, with the
/// standard deviation `sigma_m`.
struct ScanContextOptions {
  /// Number of cells along the range.
  int rings = 20;
  /// Number of cells around the sensor.
  int sectors = 60;
  /// Points further from the sensor are left out, m.
  double range_m = 40.0;
  /// Number of places that are compared in full. They are the nearest by the means of their rings.
  int compared = 50;
  /// Standard deviation of the guessed translation along each horizontal axis, m. The guess is zero.
  double sigma_m = 3.0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("rings", self.rings, between(2.0, 256.0));
    field("sectors", self.sectors, between(4.0, 720.0));
    field("range_m", self.range_m, above(0.0));
    field("compared", self.compared, at_least(1.0));
    field("sigma_m", self.sigma_m, above(0.0));
  }
};

/// A database of Scan Contexts. \throws OptionError
[[nodiscard]] LOOPWISE_EXPORT std::unique_ptr<PlaceDatabase> make_scan_context_database(
    const ScanContextOptions& options = {});

/// Density images of submaps from above. Corners and poles are key points; their binary descriptors encode
/// the gradients around them and are searched by locality-sensitive hashing. Yaw and translation come from a
/// consensus of matched key points, the similarity from the agreement of the two images.
struct DensityPlaceOptions {
  /// Edge of the columns of the image, m.
  double cell_m = 0.35;
  /// Half the width of the image, m.
  double range_m = 30.0;
  /// Maximum number of corners and poles of an image.
  int key_points = 200;
  /// Two key points match if their descriptors of 256 bits differ in at most this many bits.
  int match_bits = 64;
  /// Number of places whose images are compared. They are those with the most matches that agree on one pose.
  int compared = 15;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("cell_m", self.cell_m, above(0.0));
    field("range_m", self.range_m, above(0.0));
    field("key_points", self.key_points, between(8.0, 1000.0));
    field("match_bits", self.match_bits, between(0.0, 128.0));
    field("compared", self.compared, between(1.0, 1000.0));
  }
};

/// A database of density images. \throws OptionError, also if range_m exceeds 500 times cell_m
[[nodiscard]] LOOPWISE_EXPORT std::unique_ptr<PlaceDatabase> make_density_place_database(
    const DensityPlaceOptions& options = {});

}  // namespace loopwise
