// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Bags of ROS 1 and ROS 2 as connections and messages. Each form is a Storage (bag_storage.hpp): ROS 1 bags
/// are in bag_rosbag.cpp, those of ROS 2 in mcap.cpp and db3.cpp; what stands in for them in a build without
/// is in bag_absent.cpp and rosbag2_absent.cpp. Private to io.
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

/// What to tell a user of a build that does not.
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

/// How the bytes of messages are laid out.
enum class Encoding {
  kRos1,
  kCdr,    ///< Of ROS 2, see cdr.hpp.
  kOther,  ///< Not read.
};

/// Messages of one type under one name in one bag.
struct Connection {
  std::size_t bag = 0;  ///< In the order given.
  std::string topic;
  std::string type;        ///< "pose_graph_msgs/KeyedScan"
  std::string definition;  ///< What Schema reads; empty if it is not known.
  Encoding encoding = Encoding::kRos1;
  std::string encoding_name;  ///< As the bag has it.
  std::size_t messages = 0;
};

struct Message {
  std::size_t connection = 0;
  std::int64_t stamp_ns = 0;  ///< When it was recorded.
  std::string_view bytes;     ///< Valid during the call.
};

/// Several bags as one recording, of ROS 1 and ROS 2. Nothing is held in memory but their indexes.
class BagSet {
 public:
  using Wanted = std::function<bool(std::size_t connection)>;
  /// Handed a message; returns whether fetch() will ask for it again.
  using Visitor = std::function<bool(const Message&)>;

  /// Types whose messages for_each() may be asked for. Bags of ROS 2 are indexed for these alone.
  using Known = bool (*)(const std::string& type);

  /// Checks (see check_bag, Mcap, Db3) and opens the bags. \throws IoError; InputError; StoppedError
  BagSet(const std::vector<BagFile>& files, Known known, Problems& problems, const ProgressCallback& progress,
         const StopToken& stop);

  [[nodiscard]] const std::vector<Connection>& connections() const;

  /// Messages of the wanted connections in the order of time; of one time, in an order that is always the
  /// same. \returns how many of them fetch() knows. \throws InputError; StoppedError
  std::size_t for_each(const Wanted& wanted, const Visitor& visit, const ProgressCallback& progress,
                       const StopToken& stop);

  struct Kept {
    std::size_t connection = 0;
    std::string bytes;
  };
  /// The n-th message that a visitor asked to keep, over all calls of for_each. Safe to call from several
  /// threads, which wait for one another. Copies share the bags. \throws InputError
  [[nodiscard]] Kept fetch(std::size_t number) const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace loopwise::bags
