// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <functional>
#include <mutex>
#include <sstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/distributed/registration.hpp>
#include <loopwise/replay/replay.hpp>

#include "replay_command.hpp"

namespace loopwise::cli {
namespace {

namespace fs = std::filesystem;

/// Makes a registrar at its first use. By then rank 0 has checked the output folder, in which the registrar
/// may store outcomes.
class LateRegistrar final : public Registrar {
 public:
  explicit LateRegistrar(std::function<std::shared_ptr<const Registrar>()> make) : make_(std::move(make)) {}
  [[nodiscard]] std::string_view name() const override { return made().name(); }
  [[nodiscard]] RegistrationResult compute(const RegistrationTask& task) const override {
    return made().compute(task);
  }

 private:
  const Registrar& made() const {
    std::call_once(once_, [&] { registrar_ = make_(); });
    return *registrar_;
  }

  std::function<std::shared_ptr<const Registrar>()> make_;
  mutable std::once_flag once_;
  mutable std::shared_ptr<const Registrar> registrar_;
};

}  // namespace

int serve(const ReplayCommand& options) {
  try {
    const Config config = configured(options);
    const std::vector<fs::path> paths(options.missions.begin(), options.missions.end());
    const Mission mission = read_missions(paths, config.mission);
    const LateRegistrar registrar([&]() -> std::shared_ptr<const Registrar> {
      return make_registration(config.replay.registration, mission.scans->loader(),
                               open_store(options.replay))
          .registrar;
    });
    serve_registrations(*options.job, replay_greeting(mission, config.replay), registrar);
    return kDone;
  } catch (const Error& error) {
    report_failure(*options.job, error.what());
    return kDone;  // the first rank reports the failure and ends the job
  }
}

std::shared_ptr<WorkServer> use_ranks(const ReplayCommand& options, const Mission& mission,
                                      const ReplayOptions& replay,
                                      const std::shared_ptr<const Registrar>& registrar, ReplayHooks& hooks) {
  WorkOptions limits;
  if (options.replay.rank_time_limit_s) limits.time_limit_s = *options.replay.rank_time_limit_s;
  auto server = std::make_shared<WorkServer>(*options.job, replay_greeting(mission, replay), limits);
  hooks.compute = distributed_batches(server, registrar, std::max(1, options.common.threads));
  return server;
}

void note_ranks(Console& console, const WorkServer& server, Json& json) {
  const WorkStatistics statistics = server.statistics();
  const auto mean = [](std::size_t bytes, std::size_t messages) {
    return messages == 0 ? 0.0 : static_cast<double>(bytes) / static_cast<double>(messages);
  };
  const double request = mean(statistics.request_bytes, statistics.requests);
  const double answer = mean(statistics.answer_bytes, statistics.answers);
  json["ranks"] = {{"registrations", statistics.done},
                   {"messages", statistics.requests},
                   {"request_bytes", request},
                   {"answer_bytes", answer}};
  std::string done;
  for (const std::size_t of_rank : statistics.done)
    done += (done.empty() ? "" : ", ") + std::to_string(of_rank);
  std::ostringstream text;
  text << "registrations by rank: " << done << "; " << std::lround(request) << " B to another rank and "
       << std::lround(answer) << " B back for each";
  console.note(text.str());
}

}  // namespace loopwise::cli
