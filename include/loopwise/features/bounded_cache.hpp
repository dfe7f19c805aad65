// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <utility>

namespace loopwise {

/// Keeps costly values within a bound; the least recently used entry is removed first. Thread-safe:
/// concurrent requests for an entry compute it once and wait. Value has `std::size_t bytes() const`. Callers
/// may hold entries after their removal from the cache.
template <class K, class Value, class Hash = std::hash<K>>
class BoundedCache {
 public:
  using Pointer = std::shared_ptr<const Value>;  ///< An entry; it may outlive its place in the cache.

  /// `max_bytes` bounds the sum over the entries; the newest stays even if it alone exceeds the bound.
  explicit BoundedCache(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  /// The entry for `key`, from `make(key)` if it is missing. A null is returned and not kept; an exception of
  /// `make` is passed on. \pre make does not ask this cache for the same key.
  template <class Make>
  [[nodiscard]] Pointer get(const K& key, Make&& make) {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      const auto found = entries_.find(key);
      if (found == entries_.end()) break;
      if (!found->second.making) {
        order_.splice(order_.begin(), order_, found->second.position);
        ++hits_;
        return found->second.value;
      }
      made_.wait(lock);
    }
    entries_[key].making = true;
    lock.unlock();
    Pointer value;
    std::list<K> place;
    try {
      value = make(key);
      if (value) place.push_front(key);  // all memory is taken before anything changes
    } catch (...) {
      lock.lock();
      entries_.erase(key);
      made_.notify_all();
      throw;
    }
    lock.lock();
    ++misses_;
    if (value) {
      Entry& entry = entries_.find(key)->second;
      entry.value = value;
      entry.bytes = value->bytes();
      entry.making = false;
      order_.splice(order_.begin(), place);
      entry.position = order_.begin();
      bytes_ += entry.bytes;
      while (bytes_ > max_bytes_ && order_.size() > 1) {
        const auto oldest = entries_.find(order_.back());
        bytes_ -= oldest->second.bytes;
        entries_.erase(oldest);
        order_.pop_back();
      }
    } else {
      entries_.erase(key);
    }
    made_.notify_all();
    return value;
  }

  /// Sum over the present entries.
  [[nodiscard]] std::size_t bytes() const { return locked(bytes_); }
  /// Number of requests with a present entry.
  [[nodiscard]] std::size_t hits() const { return locked(hits_); }
  /// Number of completed calls of `make`.
  [[nodiscard]] std::size_t misses() const { return locked(misses_); }
  /// Number of present entries.
  [[nodiscard]] std::size_t size() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return order_.size();
  }

 private:
  struct Entry {
    bool making = false;
    Pointer value;
    std::size_t bytes = 0;
    typename std::list<K>::iterator position;
  };
  [[nodiscard]] std::size_t locked(const std::size_t& figure) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return figure;
  }

  const std::size_t max_bytes_;
  mutable std::mutex mutex_;
  std::condition_variable made_;
  std::unordered_map<K, Entry, Hash> entries_;
  std::list<K> order_;  // most recently used first; finished entries only
  std::size_t bytes_ = 0, hits_ = 0, misses_ = 0;
};

}  // namespace loopwise
