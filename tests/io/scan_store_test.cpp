// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/scan_store.hpp>

#include <atomic>
#include <chrono>
#include <new>
#include <thread>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>

#include "cloud_testing.hpp"
#include "testing.hpp"

namespace loopwise::scan_store_test {
namespace {

using testing::random_cloud;
using testing::TemporaryFolder;

std::shared_ptr<const PointCloud> cloud_of(std::size_t count) {
  return std::make_shared<const PointCloud>(random_cloud(count, false, false));
}

TEST_CASE("scan store: reads on demand and lists its scans", "[io][scans]") {
  const TemporaryFolder folder;
  const PointCloud cloud = random_cloud(10, false, true);
  write_pcd(folder / "7.pcd", cloud);
  const ScanStore store({{7, folder / "7.pcd"}, {9, folder / "9.pcd"}});
  CHECK(store.keys() == std::vector<Key>{7, 9});
  CHECK(store.has(9));
  CHECK_FALSE(store.has(8));
  CHECK(store.load(8) == nullptr);
  const auto first = store.load(7);
  CHECK(first->points == cloud.points);
  CHECK(store.load(7) == first);
  CHECK(store.problems().empty());
}

TEST_CASE("scan store: a broken scan is an error each time, read and counted once", "[io][scans][error]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "1.pcd", "VERSION 0.7\n");
  const ScanStore store({{1, folder / "1.pcd"}, {2, folder / "2.pcd"}});
  for (int i = 0; i < 2; ++i) {
    CHECK_THROWS_AS(store.load(1), InputError);
    CHECK_THROWS_WITH(store.load(2), Contains("2.pcd: No such file"));
  }
  write_pcd(folder / "1.pcd", random_cloud(3, false, false));
  CHECK_THROWS_WITH(store.load(1), Contains("no DATA line"));
  CHECK(store.problems().count("scan is damaged") == 1);
  CHECK(store.problems().count("scan cannot be read") == 1);
  CHECK_THAT(store.problems().all()[0].example, Contains("1.pcd"));
}

TEST_CASE("scan store: a lack of memory is no fault of the file, and blocks no other reader",
          "[io][scans][error]") {
  std::atomic<int> reads{0};
  const ScanStore store({1}, [&reads](Key) -> std::shared_ptr<const PointCloud> {
    if (++reads > 1) return cloud_of(100);
    std::this_thread::sleep_for(std::chrono::milliseconds(50));  // the others wait for this one by then
    throw std::bad_alloc();
  });
  std::atomic<int> loaded{0}, failed{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      try {
        if (store.load(1)) ++loaded;
      } catch (const std::bad_alloc&) {
        ++failed;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  CHECK(failed == 1);
  CHECK(loaded == 3);
  CHECK(store.problems().empty());
}

TEST_CASE("scan store: keeps to its bound, least recently used out first", "[io][scans]") {
  std::map<Key, int> reads;
  const auto source = [&reads](Key key) {
    ++reads[key];
    return cloud_of(100);
  };
  const std::size_t one = cloud_of(100)->bytes();
  const ScanStore store({1, 2, 3, 4}, source, 2 * one + one / 2);
  static_cast<void>(store.load(1));
  static_cast<void>(store.load(2));
  static_cast<void>(store.load(1));
  static_cast<void>(store.load(3));  // 2 goes
  CHECK(store.bytes() == 2 * one);
  static_cast<void>(store.load(1));
  CHECK(reads[1] == 1);
  static_cast<void>(store.load(2));  // 3 goes
  CHECK(reads[2] == 2);
  static_cast<void>(store.load(3));
  CHECK(reads[3] == 2);
  CHECK(store.bytes() <= 2 * one + one / 2);

  const ScanStore none({1}, source, 0);
  CHECK(none.load(1)->size() == 100);
  CHECK(none.bytes() == 0);
}

TEST_CASE("scan store: a scan that is read again is not counted again", "[io][scans]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "1.bin", "");
  const ScanStore store({{1, folder / "1.bin"}}, 0);
  static_cast<void>(store.load(1));
  static_cast<void>(store.load(1));
  CHECK(store.problems().count("empty file") == 1);
}

TEST_CASE("scan store: simultaneous requests read a scan once", "[io][scans][thread]") {
  std::atomic<int> reads{0};
  std::atomic<int> arrived{0};
  constexpr int kThreads = 4;
  const ScanStore store({5}, [&](Key) {
    while (arrived < kThreads) std::this_thread::yield();
    ++reads;
    return cloud_of(10);
  });
  std::vector<std::shared_ptr<const PointCloud>> got(kThreads);
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) {
    threads.emplace_back([&, t] {
      ++arrived;
      got[static_cast<std::size_t>(t)] = store.load(5);
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(reads == 1);
  for (const auto& cloud : got) CHECK(cloud == got[0]);
}

TEST_CASE("scan store: stays within its bound and right under many threads", "[io][scans][thread]") {
  std::vector<Key> keys;
  for (Key key = 0; key < 50; ++key) keys.push_back(key);
  const std::size_t bound = 5 * cloud_of(60)->bytes();
  const ScanStore store(
      keys,
      [](Key key) -> std::shared_ptr<const PointCloud> {
        if (key == 13) throw InputError("thirteen");
        return cloud_of(10 + static_cast<std::size_t>(key));
      },
      bound);
  std::atomic<int> wrong{0};
  std::vector<std::thread> threads;
  for (unsigned t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      Rng rng(t);
      const ScanLoader load = store.loader();
      for (int i = 0; i < 500; ++i) {
        const Key key = rng.below(51);
        try {
          const auto cloud = load(key);
          if (key == 50 ? cloud != nullptr : !cloud || cloud->size() != 10 + key || key == 13) ++wrong;
        } catch (const InputError&) {
          if (key != 13) ++wrong;
        }
        if (store.bytes() > bound) ++wrong;
      }
    });
  }
  for (auto& thread : threads) thread.join();
  CHECK(wrong == 0);
  CHECK(store.problems().count("scan is damaged") == 1);
}

TEST_CASE("scan store: its loader outlives it", "[io][scans]") {
  ScanLoader load;
  {
    const ScanStore store({1}, [](Key) { return cloud_of(2); });
    load = store.loader();
  }
  CHECK(load(1)->size() == 2);
  CHECK_THROWS_AS(ScanStore({1}, ScanLoader{}), OptionError);
  CHECK(ScanStore().empty());
}

}  // namespace
}  // namespace loopwise::scan_store_test
