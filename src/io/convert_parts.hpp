// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Common parts of the writers of all forms, and the writers for other programs. Private to io.
#pragma once

#include <atomic>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <mutex>
#include <vector>

#include <loopwise/core/error.hpp>
#include <loopwise/core/thread_pool.hpp>
#include <loopwise/io/convert.hpp>

namespace loopwise::parts {

/// \throws IoError
void make_folder(const std::filesystem::path& folder);

/// Counts parts that only a mission folder can store: frame, provenance, radio.
void count_description(const Mission& mission, Problems& left_out);

/// Calls `write` for every scan, on as many threads as the options state. \returns the number of scans that
/// could be read
template <class Write>
std::size_t write_scans(const Mission& mission, const std::vector<Key>& keys, const ConvertOptions& options,
                        Write&& write) {
  ThreadPool threads(options.threads);
  std::atomic<std::size_t> written{0};
  std::size_t done = 0;
  std::mutex mutex;
  threads.for_each(keys.size(), [&](std::size_t i) {
    if (options.stop.stop_requested()) throw StoppedError("writing was stopped");
    std::shared_ptr<const PointCloud> cloud;
    try {
      cloud = mission.scans->load(keys[i]);
    } catch (const InputError&) {
      // The store counts the error among its problems.
    }
    if (cloud) {
      write(keys[i], *cloud);
      ++written;
    }
    const std::lock_guard<std::mutex> lock(mutex);
    ++done;
    if (options.progress) options.progress({"writing scans", done, keys.size(), ""});
  });
  return written;
}

/// Writes graph.g2o, special_nodes.csv, NUMBER/data and NUMBER/cloud.pcd. \throws InputError for several
/// robots or a 2D graph
[[nodiscard]] ConvertResult write_hdl_graph_slam(const Mission& mission, const std::filesystem::path& folder,
                                                 const ConvertOptions& options);
/// Writes pose.json and pcd/NUMBER.pcd. \throws InputError for several robots
[[nodiscard]] ConvertResult write_hba(const Mission& mission, const std::filesystem::path& folder,
                                      const ConvertOptions& options);

}  // namespace loopwise::parts
