// SPDX-License-Identifier: BSD-3-Clause
#include <atomic>
#include <chrono>
#include <new>
#include <thread>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/features/bounded_cache.hpp>
#include <loopwise/features/feature_cache.hpp>
#include "testing.hpp"

namespace loopwise::cache_test {
namespace {

struct Item {
  int key = 0;
  std::size_t size = 10;
  [[nodiscard]] std::size_t bytes() const { return size; }
};
using Cache = BoundedCache<int, Item>;

Cache::Pointer make(int key) {
  return std::make_shared<const Item>(Item{key});
}

TEST_CASE("BoundedCache drops the least recently used entry", "[cache]") {
  Cache cache(30);
  for (const int key : {1, 2, 3}) REQUIRE(cache.get(key, make)->key == key);
  REQUIRE(cache.bytes() == 30);
  REQUIRE(cache.get(1, make)->key == 1);  // 2 is the oldest now
  REQUIRE(cache.get(4, make)->key == 4);
  REQUIRE(cache.size() == 3);
  REQUIRE(cache.misses() == 4);
  (void)cache.get(1, make);
  REQUIRE(cache.misses() == 4);
  (void)cache.get(2, make);
  REQUIRE(cache.misses() == 5);
  REQUIRE(cache.bytes() == 30);
}

TEST_CASE("BoundedCache keeps one entry beyond its bound, and entries in use outlive it", "[cache]") {
  Cache cache(15);
  const auto big = cache.get(1, [](int key) { return std::make_shared<const Item>(Item{key, 100}); });
  REQUIRE(cache.size() == 1);
  (void)cache.get(2, make);
  REQUIRE(cache.size() == 1);
  REQUIRE(cache.bytes() == 10);
  REQUIRE(big->size == 100);
}

TEST_CASE("BoundedCache returns nulls and exceptions without storing them", "[cache][error]") {
  Cache cache(100);
  REQUIRE(cache.get(1, [](int) { return Cache::Pointer(); }) == nullptr);
  REQUIRE_THROWS_AS(cache.get(1, [](int) -> Cache::Pointer { throw InputError("no"); }), InputError);
  REQUIRE(cache.size() == 0);
  REQUIRE(cache.get(1, make)->key == 1);
}

/// A key whose n-th copy fails to allocate.
struct ThrowingKey {
  ThrowingKey() = default;
  explicit ThrowingKey(int v) : value(v) {}
  ThrowingKey(const ThrowingKey& other) : value(other.value) {
    if (copies_left > 0 && --copies_left == 0) throw std::bad_alloc();
  }
  ThrowingKey& operator=(const ThrowingKey&) = default;
  bool operator==(const ThrowingKey& other) const { return value == other.value; }
  int value = 0;
  static int copies_left;
};
int ThrowingKey::copies_left = 0;
struct ThrowingKeyHash {
  std::size_t operator()(const ThrowingKey& key) const { return std::hash<int>()(key.value); }
};

TEST_CASE("BoundedCache: an allocation failure at any point changes nothing", "[cache][error]") {
  const auto make_item = [](const ThrowingKey& key) { return std::make_shared<const Item>(Item{key.value}); };
  int failed = 0;
  for (int at = 1; at < 10; ++at) {
    CAPTURE(at);
    BoundedCache<ThrowingKey, Item, ThrowingKeyHash> cache(20);
    for (const int key : {1, 2}) REQUIRE(cache.get(ThrowingKey(key), make_item)->key == key);
    ThrowingKey::copies_left = at;
    try {
      (void)cache.get(ThrowingKey(3), make_item);
    } catch (const std::bad_alloc&) {
      ++failed;
    }
    ThrowingKey::copies_left = 0;
    // With an unfinished entry, other threads would wait for ever, or use an invalid iterator.
    for (const int key : {3, 1, 2, 3}) REQUIRE(cache.get(ThrowingKey(key), make_item)->key == key);
    REQUIRE(cache.bytes() == 20);
    REQUIRE(cache.size() == 2);
  }
  REQUIRE(failed >= 2);
}

TEST_CASE("BoundedCache makes an entry once for threads that ask at the same time", "[cache][thread]") {
  Cache cache(1000);
  std::atomic<int> made{0};
  ThreadPool pool(4);
  pool.for_each(64, [&](std::size_t i) {
    const int key = static_cast<int>(i % 3);
    const auto item = cache.get(key, [&](int wanted) {
      ++made;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      return make(wanted);
    });
    if (item->key != key) throw InputError("wrong entry");
  });
  REQUIRE(made == 3);
  REQUIRE(cache.hits() + cache.misses() == 64);
}

TEST_CASE("BoundedCache: a thread that waited for a failure tries itself", "[cache][thread][error]") {
  Cache cache(1000);
  std::atomic<int> calls{0}, failures{0}, successes{0};
  ThreadPool pool(4);
  pool.for_each(8, [&](std::size_t) {
    try {
      const auto item = cache.get(1, [&](int key) -> Cache::Pointer {
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
        if (calls++ < 3) throw InputError("not yet");
        return make(key);
      });
      if (item) ++successes;
    } catch (const InputError&) {
      ++failures;
    }
  });
  REQUIRE(failures == 3);
  REQUIRE(successes == 5);
}

TEST_CASE("FeatureCache computes once a scan, within its bound", "[cache][features]") {
  std::atomic<int> loads{0};
  const ScanLoader loader = [&](Key key) -> std::shared_ptr<const PointCloud> {
    ++loads;
    if (key == 9) return nullptr;
    if (key == 8) throw IoError("8.pcd", "cannot be read");
    auto cloud = std::make_shared<PointCloud>();
    Rng rng(key);
    for (int i = 0; i < 500; ++i) {
      cloud->points.push_back(Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).cast<float>());
    }
    return cloud;
  };
  FeatureCache cache(loader);
  const auto first = cache.get(1);
  REQUIRE(first->cloud.has_normals());
  REQUIRE(cache.get(1) == first);
  REQUIRE(loads == 1);
  REQUIRE(cache.get(9) == nullptr);
  REQUIRE_THROWS_AS(cache.get(8), IoError);

  FeatureOptions tight;
  tight.max_cache_mb = 1e-6;
  FeatureCache small(loader, tight);
  (void)small.get(1);
  (void)small.get(2);
  (void)small.get(1);
  REQUIRE(small.computed() == 3);

  REQUIRE_THROWS_AS(FeatureCache(ScanLoader()), InputError);
  FeatureOptions bad;
  bad.normal_neighbours = 2;
  REQUIRE_THROWS_WITH(FeatureCache(loader, bad), "normal_neighbours = 2, must be in [3, 100]");
}

}  // namespace
}  // namespace loopwise::cache_test
