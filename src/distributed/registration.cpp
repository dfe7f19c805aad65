// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/registration.hpp>

#include <algorithm>
#include <mutex>
#include <numeric>
#include <tuple>
#include <utility>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/registration/batch.hpp>
#include <loopwise/replay/code_version.hpp>

#include "byte_stream.hpp"

namespace loopwise {
namespace {

void put(ByteWriter& out, const std::vector<SubmapMember>& members) {
  out.put(static_cast<std::uint8_t>(members.size()));
  for (const SubmapMember& member : members) {
    const bool centre = member.T_center_member.matrix() == Eigen::Matrix4d::Identity() &&
                        member.covariance == Matrix6d::Zero();
    out.put(member.key).put(static_cast<std::uint8_t>(centre));
    if (!centre) out.put(member.T_center_member).matrix(member.covariance);
  }
}

std::vector<SubmapMember> get_members(ByteReader& in) {
  std::vector<SubmapMember> members(in.get<std::uint8_t>());
  for (SubmapMember& member : members) {
    member.key = in.get<Key>();
    if (in.flag()) continue;
    member.T_center_member = in.pose();
    member.covariance = in.matrix<Matrix6d>();
  }
  return members;
}

}  // namespace

std::string pack_task(const RegistrationTask& task) {
  if (task.source.size() > 255 || task.target.size() > 255) {
    throw InputError("a submap of more than 255 scans cannot be sent");
  }
  const LoopCandidate& c = task.candidate;
  ByteWriter out;
  out.put(c.id)
      .put(c.from)
      .put(c.to)
      .put(static_cast<std::uint8_t>(c.source))
      .put(c.time_s)
      .put(c.distance_m);
  out.put(task.seed).put(static_cast<std::uint64_t>(task.enough_points)).put(task.time_limit_s);
  out.put(static_cast<std::uint8_t>(task.guess_from_to.has_value()));
  if (task.guess_from_to) out.put(*task.guess_from_to);
  out.put(static_cast<std::uint8_t>(task.guess_covariance.has_value()));
  if (task.guess_covariance) out.matrix(*task.guess_covariance);
  put(out, task.source);
  put(out, task.target);
  return out.take();
}

RegistrationTask unpack_task(std::string_view bytes) {
  ByteReader in(bytes);
  RegistrationTask task;
  LoopCandidate& c = task.candidate;
  c.id = in.get<CandidateId>();
  c.from = in.get<Key>();
  c.to = in.get<Key>();
  const auto last_source = static_cast<std::uint8_t>(enum_names(CandidateSource{}).back().first);
  c.source = static_cast<CandidateSource>(in.one_of(last_source));
  c.time_s = in.get<double>();
  c.distance_m = in.get<double>();
  task.seed = in.get<std::uint64_t>();
  task.enough_points = static_cast<std::size_t>(in.get<std::uint64_t>());
  task.time_limit_s = in.get<double>();
  if (in.flag()) task.guess_from_to = in.pose();
  if (in.flag()) task.guess_covariance = in.matrix<Matrix6d>();
  task.source = get_members(in);
  task.target = get_members(in);
  in.end();
  return task;
}

std::string replay_greeting(const Mission& mission, const ReplayOptions& options) {
  ContentHasher hasher;
  for (const Node& node : mission.graph.nodes()) {
    hasher.integer(node.key).integer(static_cast<std::uint64_t>(node.stamp_ns));
  }
  for (const Key key : mission.scans->keys()) hasher.integer(key);
  return "replay " + replay_code_version() + " " + to_string(hasher.finish()) + " " +
         to_string(ContentHasher().text(options_key(options)).finish());
}

BatchComputer distributed_batches(std::shared_ptr<WorkServer> server,
                                  std::shared_ptr<const Registrar> registrar, int local_workers) {
  return
      [server = std::move(server), registrar = std::move(registrar), local_workers](
          const std::vector<RegistrationTask>& tasks, const StopToken& stop, const ProgressCallback& progress,
          const std::function<void(const RegistrationResult&)>& on_result) {
        // Sorted by target, then source, so that one rank computes pairs with common scans one after the
        // other.
        std::vector<std::size_t> order(tasks.size());
        std::iota(order.begin(), order.end(), std::size_t{0});
        std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
          const LoopCandidate &x = tasks[a].candidate, &y = tasks[b].candidate;
          return std::tie(x.to, x.from, a) < std::tie(y.to, y.from, b);
        });
        std::vector<Work> work;
        work.reserve(order.size());
        for (const std::size_t i : order) work.push_back({pack_task(tasks[i]), tasks[i].candidate.to});
        std::vector<std::optional<RegistrationResult>> results(tasks.size());
        std::mutex mutex;
        std::size_t accepted = 0, rejected = 0;
        const auto take = [&](std::size_t i, RegistrationResult result) {
          const std::lock_guard<std::mutex> lock(mutex);
          results[i] = std::move(result);
          if (on_result) on_result(*results[i]);
          ++(results[i]->verified() ? accepted : rejected);
          if (progress) {
            progress({"registering", accepted + rejected, tasks.size(),
                      std::to_string(accepted) + " accepted, " + std::to_string(rejected) + " rejected"});
          }
        };
        server->run(
            work, local_workers,
            [&](std::size_t k) { take(order[k], compute_or_fail(*registrar, tasks[order[k]])); },
            [&](int, std::size_t k, std::string_view answer) {
              take(order[k], unpack_result(answer, tasks[order[k]].candidate));
            },
            stop);
        return results;
      };
}

void serve_registrations(Transport& transport, std::string_view greeting, const Registrar& registrar) {
  serve_work(transport, greeting, [&](std::string_view request) {
    return pack_result(compute_or_fail(registrar, unpack_task(request)));
  });
}

}  // namespace loopwise
