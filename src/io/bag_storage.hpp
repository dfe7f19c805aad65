// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Interface of a form of bag, for BagSet. Private to io.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "bag.hpp"

namespace loopwise::bags {

/// Position of a message in its storage.
struct Entry {
  std::int64_t stamp_ns = 0;  ///< When it was recorded.
  std::uint64_t place = 0;    ///< In the units of the storage.
  std::uint32_t offset = 0;   ///< From the place.
  std::uint32_t connection = 0;
};

/// Largest number of indexed messages in a bag of ROS 2: more than a day at a hundred messages per second.
inline constexpr std::size_t kMostMessages = std::size_t{1} << 24;

/// Largest size of a chunk, or of a message that is compressed individually.
inline constexpr std::size_t kLargestPiece = std::size_t{1} << 28;

/// One bag, or several that one library reads together.
class Storage {
 public:
  virtual ~Storage() = default;
  [[nodiscard]] const std::vector<Connection>& connections() const { return connections_; }
  /// Messages of the wanted connections in the order of time. \throws InputError
  [[nodiscard]] virtual std::vector<Entry> index(const std::vector<bool>& wanted) = 0;
  /// The message, as it was recorded. Not safe to call from several threads. \throws InputError naming the
  /// file, the topic and the place
  [[nodiscard]] virtual std::string read(const Entry& entry) = 0;

 protected:
  std::vector<Connection> connections_;
};

/// The wanted entries of `all`, in the order of time.
[[nodiscard]] std::vector<Entry> sorted(const std::vector<Entry>& all, const std::vector<bool>& wanted);

/// Arguments for opening a bag, besides its file.
struct Opening {
  BagSet::Known known;
  Problems& problems;
  const ProgressCallback& progress;
  const StopToken& stop;
};

/// A bag and its number in the order given.
struct NumberedFile {
  std::size_t number = 0;
  BagFile file;
};

/// Bags of ROS 1, read as one.
[[nodiscard]] std::unique_ptr<Storage> open_rosbags(const std::vector<NumberedFile>& files,
                                                    const Opening& opening);
/// A bag of ROS 2 in MCAP or SQLite, which may be compressed as a whole.
[[nodiscard]] std::unique_ptr<Storage> open_rosbag2(const NumberedFile& file, const Opening& opening);

}  // namespace loopwise::bags
