// SPDX-License-Identifier: BSD-3-Clause
// Bags of all forms as one recording.
#include <algorithm>
#include <mutex>

#include <loopwise/core/error.hpp>

#include "bag_storage.hpp"
#include "mission_parts.hpp"

namespace loopwise::bags {
namespace {

struct Place {
  std::size_t storage = 0;
  Entry entry;
};

}  // namespace

struct BagSet::State {
  std::vector<std::unique_ptr<Storage>> storages;
  std::vector<std::size_t> begins;  // first connection of each storage among all connections
  std::vector<Connection> connections;
  std::vector<Place> kept;
  std::string name;
  std::mutex mutex;  // a storage has one read position and one chunk in memory

  void add(std::unique_ptr<Storage> storage) {
    begins.push_back(connections.size());
    connections.insert(connections.end(), storage->connections().begin(), storage->connections().end());
    storages.push_back(std::move(storage));
  }
  [[nodiscard]] std::size_t connection_of(const Place& place) const {
    return begins[place.storage] + place.entry.connection;
  }
};

std::vector<Entry> sorted(const std::vector<Entry>& all, const std::vector<bool>& wanted) {
  std::vector<Entry> out;
  std::copy_if(all.begin(), all.end(), std::back_inserter(out),
               [&](const Entry& entry) { return wanted[entry.connection]; });
  std::stable_sort(out.begin(), out.end(),
                   [](const Entry& a, const Entry& b) { return a.stamp_ns < b.stamp_ns; });
  return out;
}

BagSet::BagSet(const std::vector<BagFile>& files, Known known, Problems& problems,
               const ProgressCallback& progress, const StopToken& stop)
    : state_(std::make_shared<State>()) {
  const Opening opening{known, problems, progress, stop};
  std::vector<NumberedFile> ros1;
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (parts::begins_with(files[i].path, "#ROSBAG")) ros1.push_back({i, files[i]});
  }
  if (!ros1.empty()) state_->add(open_rosbags(ros1, opening));
  for (std::size_t i = 0; i < files.size(); ++i) {
    const bool is_ros1 =
        std::any_of(ros1.begin(), ros1.end(), [&](const NumberedFile& file) { return file.number == i; });
    if (!is_ros1) state_->add(open_rosbag2({i, files[i]}, opening));
  }
  state_->name = files.size() == 1 ? files[0].name : std::to_string(files.size()) + " bags";
}

const std::vector<Connection>& BagSet::connections() const {
  return state_->connections;
}

std::size_t BagSet::for_each(const Wanted& wanted, const Visitor& visit, const ProgressCallback& progress,
                             const StopToken& stop) {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  std::vector<Place> places;
  for (std::size_t s = 0; s < state_->storages.size(); ++s) {
    std::vector<bool> of_storage;
    for (std::size_t i = 0; i < state_->storages[s]->connections().size(); ++i)
      of_storage.push_back(wanted(state_->begins[s] + i));
    for (const Entry& entry : state_->storages[s]->index(of_storage)) places.push_back({s, entry});
  }
  std::stable_sort(places.begin(), places.end(),
                   [](const Place& a, const Place& b) { return a.entry.stamp_ns < b.entry.stamp_ns; });
  std::size_t done = 0;
  for (const Place& place : places) {
    if (stop.stop_requested()) throw StoppedError("reading " + state_->name + " was stopped");
    const std::string bytes = state_->storages[place.storage]->read(place.entry);
    if (visit({state_->connection_of(place), place.entry.stamp_ns, bytes})) state_->kept.push_back(place);
    if (progress) progress({"reading " + state_->name, ++done, places.size(), "messages"});
  }
  return state_->kept.size();
}

BagSet::Kept BagSet::fetch(std::size_t number) const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  const Place& place = state_->kept.at(number);
  Kept out;
  out.connection = state_->connection_of(place);
  out.bytes = state_->storages[place.storage]->read(place.entry);
  return out;
}

}  // namespace loopwise::bags
