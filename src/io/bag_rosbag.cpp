// SPDX-License-Identifier: BSD-3-Clause
#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <map>

#include <loopwise/core/error.hpp>

#include "bag_check.hpp"
#include "bag_storage.hpp"

namespace loopwise::bags {
namespace {

std::int64_t nanoseconds(const ros::Time& time) {
  return static_cast<std::int64_t>(time.sec) * 1'000'000'000 + static_cast<std::int64_t>(time.nsec);
}

/// Calls the library and adds the file to its errors.
template <class Call>
auto call_library(const std::string& name, Call&& call) -> decltype(call()) {
  try {
    return call();
  } catch (const Error&) {
    throw;
  } catch (const std::exception& error) {
    throw InputError(name + ": " + error.what());
  }
}

class Rosbags : public Storage {
 public:
  Rosbags(const std::vector<NumberedFile>& files, const Opening& opening) {
    for (const auto& [number, file] : files) {
      check_bag(file.path, file.name, opening.problems, opening.progress, opening.stop);
      call_library(file.name, [&, bag_number = number, &path = file.path, &name = file.name] {
        auto bag = std::make_unique<rosbag::Bag>(path.string());
        rosbag::View view(*bag);
        std::map<const std::string*, std::size_t> counts;
        for (const rosbag::MessageInstance& message : view) ++counts[&message.getTopic()];
        for (const rosbag::ConnectionInfo* info : view.getConnections()) {
          connections_.push_back({bag_number, info->topic, info->datatype, info->msg_def, Encoding::kRos1,
                                  "ros1", counts[&info->topic]});
          infos_.push_back(info);
        }
        bags_.push_back(std::move(bag));
        names_[bag_number] = name;
      });
    }
  }

  std::vector<Entry> index(const std::vector<bool>& wanted) override {
    // Only the address of the topic's name in a message identifies the connection.
    std::map<const std::string*, std::uint32_t> topics;
    for (std::size_t i = 0; i < infos_.size(); ++i) {
      if (wanted[i]) topics[&infos_[i]->topic] = static_cast<std::uint32_t>(i);
    }
    const std::string name =
        names_.size() == 1 ? names_.begin()->second : std::to_string(names_.size()) + " bags";
    return call_library(name, [&] {
      rosbag::View view;
      for (const auto& bag : bags_) {
        view.addQuery(*bag,
                      [&](const rosbag::ConnectionInfo* info) { return topics.count(&info->topic) != 0; });
      }
      std::vector<Entry> entries;
      for (const rosbag::MessageInstance& message : view) {
        entries.push_back(
            {nanoseconds(message.getTime()), messages_.size(), 0, topics.at(&message.getTopic())});
        messages_.push_back(message);
      }
      return entries;
    });
  }

  std::string read(const Entry& entry) override {
    return call_library(names_.at(connections_[entry.connection].bag), [&] {
      const rosbag::MessageInstance& message = messages_[entry.place];
      std::string bytes(message.size(), '\0');
      ros::serialization::OStream stream(reinterpret_cast<std::uint8_t*>(bytes.data()),
                                         static_cast<std::uint32_t>(bytes.size()));
      message.write(stream);
      return bytes;
    });
  }

 private:
  std::vector<std::unique_ptr<rosbag::Bag>> bags_;
  std::map<std::size_t, std::string> names_;          // by the bags' numbers
  std::vector<const rosbag::ConnectionInfo*> infos_;  // as connections_
  std::vector<rosbag::MessageInstance> messages_;     // of all indexes asked for
};

}  // namespace

bool available() {
  return true;
}

std::unique_ptr<Storage> open_rosbags(const std::vector<NumberedFile>& files, const Opening& opening) {
  return std::make_unique<Rosbags>(files, opening);
}

}  // namespace loopwise::bags
