// SPDX-License-Identifier: BSD-3-Clause
#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <mutex>

#include <loopwise/core/error.hpp>

#include "bag.hpp"
#include "bag_check.hpp"

namespace loopwise::bags {
namespace {

std::int64_t nanoseconds(const ros::Time& time) {
  return static_cast<std::int64_t>(time.sec) * 1'000'000'000 + static_cast<std::int64_t>(time.nsec);
}

/// Calls the library, whose errors know no file.
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

void copy_bytes(const rosbag::MessageInstance& message, std::string& bytes) {
  bytes.resize(message.size());
  ros::serialization::OStream stream(reinterpret_cast<std::uint8_t*>(bytes.data()),
                                     static_cast<std::uint32_t>(bytes.size()));
  message.write(stream);
}

}  // namespace

struct BagSet::State {
  struct Open {
    std::string name;
    std::unique_ptr<rosbag::Bag> bag;
  };
  struct Remembered {
    std::size_t connection;
    rosbag::MessageInstance message;
  };
  std::vector<Open> bags;
  std::vector<Connection> connections;
  std::vector<const rosbag::ConnectionInfo*> infos;  // as connections
  std::vector<Remembered> kept;
  std::mutex mutex;  // a bag has one place in its file and one chunk in memory
};

bool available() {
  return true;
}

BagSet::BagSet(const std::vector<BagFile>& files, Problems& problems, const ProgressCallback& progress,
               const StopToken& stop)
    : state_(std::make_shared<State>()) {
  for (const BagFile& file : files) {
    check_bag(file.path, file.name, problems, progress, stop);
    call_library(file.name, [&] {
      auto bag = std::make_unique<rosbag::Bag>(file.path.string());
      rosbag::View view(*bag);
      for (const rosbag::ConnectionInfo* info : view.getConnections()) {
        state_->connections.push_back({state_->bags.size(), info->topic, info->datatype, info->msg_def});
        state_->infos.push_back(info);
      }
      state_->bags.push_back({file.name, std::move(bag)});
    });
  }
}

const std::vector<Connection>& BagSet::connections() const {
  return state_->connections;
}

std::size_t BagSet::for_each(const Wanted& wanted, const Visitor& visit, const ProgressCallback& progress,
                             const StopToken& stop) {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  // A message tells its connection only by the address of the topic's name.
  std::map<const std::string*, std::size_t> wanted_topics;
  for (std::size_t i = 0; i < state_->infos.size(); ++i) {
    if (wanted(state_->connections[i])) wanted_topics[&state_->infos[i]->topic] = i;
  }
  const std::string name =
      state_->bags.size() == 1 ? state_->bags[0].name : std::to_string(state_->bags.size()) + " bags";
  call_library(name, [&] {
    rosbag::View view;
    for (const State::Open& open : state_->bags) {
      view.addQuery(*open.bag, [&](const rosbag::ConnectionInfo* info) {
        return wanted_topics.count(&info->topic) != 0;
      });
    }
    const std::size_t total = view.size();
    std::size_t done = 0;
    std::string bytes;
    for (const rosbag::MessageInstance& message : view) {
      if (stop.stop_requested()) throw StoppedError("reading " + name + " was stopped");
      const std::size_t connection = wanted_topics.at(&message.getTopic());
      copy_bytes(message, bytes);
      if (visit({connection, nanoseconds(message.getTime()), bytes})) {
        state_->kept.push_back({connection, message});
      }
      if (progress) progress({"reading " + name, ++done, total, "messages"});
    }
  });
  return state_->kept.size();
}

BagSet::Kept BagSet::fetch(std::size_t number) const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  const State::Remembered& kept = state_->kept.at(number);
  Kept out;
  out.connection = kept.connection;
  call_library(state_->bags[state_->connections[kept.connection].bag].name,
               [&] { copy_bytes(kept.message, out.bytes); });
  return out;
}

}  // namespace loopwise::bags
