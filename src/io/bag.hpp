// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Bags of ROS 1 and ROS 2 as connections and messages. Each form is a Storage (bag_storage.hpp): ROS 1 bags
/// are in bag_rosbag.cpp, those of ROS 2 in mcap.cpp and db3.cpp. bag_absent.cpp and rosbag2_absent.cpp
/// replace them in a build without bags. Private to io.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/problems.hpp>
#include <loopwise/core/progress.hpp>
#include <loopwise/core/stop_token.hpp>

namespace loopwise::bags {

/// Whether this build reads bags of ROS 1.
[[nodiscard]] bool available();

/// Whether this build reads bags of ROS 2.
[[nodiscard]] bool rosbag2_available();

/// Message for the user of a build without bags of ROS 1.
inline constexpr const char* kUnavailable =
    "this program was built without ROS bags (LOOPWISE_WITH_ROSBAG; Debian: librosbag-storage-dev)";

/// The same for bags of ROS 2.
inline constexpr const char* kRosbag2Unavailable =
    "this program was built without ROS 2 bags (LOOPWISE_WITH_ROSBAG2; Debian: libsqlite3-dev libzstd-dev "
    "liblz4-dev)";

struct BagFile {
  std::filesystem::path path;
  std::string name;  ///< For errors and problems: the path, unless the file is a copy of something else.
};

/// Encoding of the bytes of a message.
enum class Encoding {
  kRos1,
  kCdr,    ///< Of ROS 2, see cdr.hpp.
  kOther,  ///< Any other, which is not read.
};

/// Messages of one type under one name in one bag.
struct Connection {
  std::size_t bag = 0;  ///< In the order given.
  std::string topic;
  std::string type;        ///< "pose_graph_msgs/KeyedScan"
  std::string definition;  ///< Input of Schema; empty if it is not known.
  Encoding encoding = Encoding::kRos1;
  std::string encoding_name;  ///< As in the bag.
  std::size_t messages = 0;
};

struct Message {
  std::size_t connection = 0;
  std::int64_t stamp_ns = 0;  ///< Time of the recording.
  std::string_view bytes;     ///< Valid during the call.
};

/// Several bags of ROS 1 and ROS 2 as one recording. Only their indexes are held in memory.
class BagSet {
 public:
  using Wanted = std::function<bool(std::size_t connection)>;
  /// Receives a message and returns whether to keep it for fetch().
  using Visitor = std::function<bool(const Message&)>;

  /// Whether for_each() may be asked for messages of a type. Bags of ROS 2 are indexed only for these types.
  using Known = bool (*)(const std::string& type);

  /// Checks (see check_bag, Mcap, Db3) and opens the bags. \throws IoError; InputError; StoppedError
  BagSet(const std::vector<BagFile>& files, Known known, Problems& problems, const ProgressCallback& progress,
         const StopToken& stop);

  [[nodiscard]] const std::vector<Connection>& connections() const;

  /// Visits messages of the wanted connections in the order of time. Messages of one time have a fixed order.
  /// \returns the number of messages that fetch() knows. \throws InputError; StoppedError
  std::size_t for_each(const Wanted& wanted, const Visitor& visit, const ProgressCallback& progress,
                       const StopToken& stop);

  struct Kept {
    std::size_t connection = 0;
    std::string bytes;
  };
  /// The n-th message that a visitor kept, counted over all calls of for_each(). Safe to call from several
  /// threads, of which one reads at a time. Copies share the bags. \throws InputError
  [[nodiscard]] Kept fetch(std::size_t number) const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace loopwise::bags
