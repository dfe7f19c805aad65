// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// ROS 1 bags as connections and messages. The one place that knows the library behind it is bag_rosbag.cpp;
/// bag_absent.cpp stands in for it in a build without. Private to io.
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

/// Whether this build reads bags.
[[nodiscard]] bool available();

/// What to tell a user of a build that does not.
inline constexpr const char* kUnavailable =
    "this program was built without ROS bags (LOOPWISE_WITH_ROSBAG; Debian: librosbag-storage-dev)";

/// Whether the file begins like a bag, of whatever version. \throws IoError
[[nodiscard]] bool is_bag(const std::filesystem::path& file);

struct BagFile {
  std::filesystem::path path;
  std::string name;  ///< For errors and problems: the path, unless the file is a copy of something else.
};

/// Messages of one type under one name in one bag.
struct Connection {
  std::size_t bag = 0;  ///< In the order given.
  std::string topic;
  std::string type;        ///< "pose_graph_msgs/KeyedScan"
  std::string definition;  ///< What Schema reads.
};

struct Message {
  std::size_t connection = 0;
  std::int64_t stamp_ns = 0;  ///< When it was recorded.
  std::string_view bytes;     ///< Valid during the call.
};

/// Several bags as one recording. Nothing is held in memory but their indexes.
class BagSet {
 public:
  using Wanted = std::function<bool(const Connection&)>;
  /// Handed a message; returns whether fetch() will ask for it again.
  using Visitor = std::function<bool(const Message&)>;

  /// Checks (see check_bag) and opens the bags. \throws IoError; InputError; StoppedError
  BagSet(const std::vector<BagFile>& files, Problems& problems, const ProgressCallback& progress,
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
