// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/scan_store.hpp>

#include <algorithm>
#include <condition_variable>
#include <iomanip>
#include <list>
#include <mutex>
#include <new>
#include <optional>
#include <sstream>
#include <utility>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>

namespace loopwise {
namespace {

std::string far_from_sensor(Key key, const std::filesystem::path& file, const Eigen::Vector3d& middle) {
  std::ostringstream out;
  out << (file.empty() ? "" : file.string() + ": ") << "scan " << key_name(key)
      << ": the centre of its points is at " << std::fixed << std::setprecision(0) << middle.x() << " "
      << middle.y() << " " << middle.z()
      << " m: scans must be in the frame of their node, not in world coordinates; move each by the inverse "
         "of "
         "its node's pose";
  return out.str();
}

}  // namespace

struct ScanStore::State {
  enum class Stage { kNotRead, kBeingRead, kKept, kFailed };
  struct Entry {
    std::filesystem::path file;  // empty if a loader provides the scans
    Part part;                   // scan of another store, which then loads and caches it
    Stage stage = Stage::kNotRead;
    std::shared_ptr<const PointCloud> cloud;
    std::size_t bytes = 0;
    std::list<Key>::iterator recency;  // valid while kept
    std::string failure;
    bool counted = false;  // its problems are counted; a scan may be read several times
    Problems problems;
  };

  /// Marks a scan as being read. The destructor wakes all threads that wait for the scan, even after an
  /// error.
  struct Reading {
    State& state;
    Entry& entry;
    std::unique_lock<std::mutex>& lock;
    ~Reading() {
      if (!lock.owns_lock()) lock.lock();
      if (entry.stage == Stage::kBeingRead) entry.stage = Stage::kNotRead;
      state.read.notify_all();
    }
  };

  std::size_t max_bytes = 0;
  BinLayout bin_layout = BinLayout::kAuto;
  ScanLoader source;
  CloudSource clouds;
  mutable std::mutex mutex;
  std::condition_variable read;  // some scan left kBeingRead
  std::map<Key, Entry> entries;  // the set of keys never changes
  std::list<Key> recency;        // most recently used first
  std::size_t bytes = 0;
  std::vector<std::shared_ptr<const ScanStore>> stores;  // of the parts, each once

  std::shared_ptr<const PointCloud> load(Key key) {
    std::unique_lock<std::mutex> lock(mutex);
    const auto found = entries.find(key);
    if (found == entries.end()) return nullptr;
    Entry& entry = found->second;
    if (entry.part.store) {
      lock.unlock();
      return entry.part.store->load(entry.part.key);
    }
    read.wait(lock, [&entry] { return entry.stage != Stage::kBeingRead; });
    if (entry.stage == Stage::kFailed) throw InputError(entry.failure);
    if (entry.stage == Stage::kKept) {
      recency.splice(recency.begin(), recency, entry.recency);
      return entry.cloud;
    }

    entry.stage = Stage::kBeingRead;
    lock.unlock();
    CloudFile loaded;
    std::shared_ptr<const PointCloud> cloud;
    std::optional<std::string> failure;
    const char* kind = "scan cannot be read";
    std::list<Key> place;
    const Reading reading{*this, entry, lock};
    try {
      if (source) {
        cloud = source(key);
        if (!cloud) failure = "scan " + key_name(key) + " is missing";
      } else {
        loaded = clouds ? clouds(key) : read_cloud(entry.file, bin_layout);
        if (!loaded.cloud.origin.isZero(0.0)) {
          throw InputError(far_from_sensor(key, entry.file, loaded.cloud.origin));
        }
        cloud = std::make_shared<const PointCloud>(std::move(loaded.cloud));
      }
      place.push_front(key);
    } catch (const std::bad_alloc&) {  // not a fault of the file, so a later call tries again
      throw;
    } catch (const InputError& error) {
      failure = error.what();
      kind = "scan is damaged";
    } catch (const std::exception& error) {
      failure = error.what();
    } catch (...) {
      failure = "scan " + key_name(key) + " cannot be read";
    }
    lock.lock();
    if (failure) {
      entry.failure = *failure;
      entry.problems.add_altered(kind, *failure);
      entry.stage = Stage::kFailed;
      throw InputError(*failure);
    }
    if (!entry.counted) entry.problems = std::move(loaded.problems);
    entry.counted = true;
    keep(entry, cloud, place);
    return cloud;
  }

  /// `place` is an element for the list of recency. The caller allocates it, so that this function cannot
  /// fail.
  void keep(Entry& entry, const std::shared_ptr<const PointCloud>& cloud, std::list<Key>& place) {
    entry.stage = Stage::kNotRead;
    const std::size_t size = cloud->bytes();
    if (size > max_bytes) return;
    while (bytes + size > max_bytes) {
      Entry& oldest = entries.at(recency.back());
      bytes -= oldest.bytes;
      oldest.cloud.reset();
      oldest.stage = Stage::kNotRead;
      recency.pop_back();
    }
    recency.splice(recency.begin(), place);
    entry.stage = Stage::kKept;
    entry.cloud = cloud;
    entry.bytes = size;
    entry.recency = recency.begin();
    bytes += size;
  }
};

ScanStore::ScanStore(std::map<Key, std::filesystem::path> files, std::size_t max_bytes, BinLayout bin_layout)
    : state_(std::make_shared<State>()) {
  state_->max_bytes = max_bytes;
  state_->bin_layout = bin_layout;
  for (auto& entry : files) state_->entries[entry.first].file = std::move(entry.second);
}

ScanStore::ScanStore(const std::vector<Key>& keys, ScanLoader source, std::size_t max_bytes)
    : state_(std::make_shared<State>()) {
  if (!source) throw OptionError("scan store: the source is an empty function");
  state_->max_bytes = max_bytes;
  state_->source = std::move(source);
  for (const Key key : keys) state_->entries[key];
}

ScanStore::ScanStore(const std::vector<Key>& keys, CloudSource source, std::size_t max_bytes)
    : state_(std::make_shared<State>()) {
  if (!source) throw OptionError("scan store: the source is an empty function");
  state_->max_bytes = max_bytes;
  state_->clouds = std::move(source);
  for (const Key key : keys) state_->entries[key];
}

ScanStore::ScanStore(std::map<Key, Part> parts) : state_(std::make_shared<State>()) {
  for (auto& entry : parts) {
    Part& part = entry.second;
    if (!part.store) throw OptionError("scan store: a part without a store");
    auto& stores = state_->stores;
    if (std::find(stores.begin(), stores.end(), part.store) == stores.end()) stores.push_back(part.store);
    state_->entries[entry.first].part = std::move(part);
  }
}

bool ScanStore::has(Key key) const {
  return state_->entries.count(key) != 0;
}

std::vector<Key> ScanStore::keys() const {
  std::vector<Key> keys;
  keys.reserve(state_->entries.size());
  for (const auto& [key, entry] : state_->entries) keys.push_back(key);
  return keys;
}

std::size_t ScanStore::size() const {
  return state_->entries.size();
}

std::shared_ptr<const PointCloud> ScanStore::load(Key key) const {
  return state_->load(key);
}

Problems ScanStore::problems() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  Problems all;
  for (const auto& [key, entry] : state_->entries) all.add(entry.problems);
  for (const auto& store : state_->stores) all.add(store->problems());
  return all;
}

std::size_t ScanStore::bytes() const {
  const std::lock_guard<std::mutex> lock(state_->mutex);
  std::size_t bytes = state_->bytes;
  for (const auto& store : state_->stores) bytes += store->bytes();
  return bytes;
}

ScanLoader ScanStore::loader() const {
  return [state = state_](Key key) { return state->load(key); };
}

}  // namespace loopwise
