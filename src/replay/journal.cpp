// SPDX-License-Identifier: BSD-3-Clause
#include "journal.hpp"

#include <nlohmann/json.hpp>

#include <loopwise/io/json_options.hpp>

#include "outcome_json.hpp"

namespace loopwise {
namespace {

Json account_json(const CandidateAccounting& a) {
  return {{"generated", a.generated}, {"pruned", a.pruned},   {"expired", a.expired},
          {"waiting", a.waiting},     {"pending", a.pending}, {"in_flight", a.in_flight},
          {"computed", a.computed}};
}

Json new_line(const char* name, double time_s) {
  return {{"event", name}, {"time_s", time_s}};
}

std::string finish(Json line, const CandidateAccounting& a) {
  line["account"] = account_json(a);
  return json_text(line);
}

}  // namespace

namespace journal {

std::string start_line(const Mission& mission, const ReplayOptions& options) {
  Json line = new_line("start", 0.0);
  line["format"] = 1;
  line["mission"] = mission.name;
  line["key_frames"] = mission.graph.nodes().size();
  line["options"] = parse_json(options_json(options), "options");
  return finish(std::move(line), {});
}

std::string key_frame_line(double time_s, Key key, std::size_t candidates, const CandidateAccounting& a) {
  Json line = new_line("key_frame", time_s);
  line["key"] = std::to_string(key);
  line["candidates"] = candidates;
  return finish(std::move(line), a);
}

std::string batch_line(double time_s, const std::vector<RegistrationTask>& batch,
                       const CandidateAccounting& a) {
  Json line = new_line("batch", time_s);
  Json pairs = Json::array();
  for (const RegistrationTask& task : batch) {
    pairs.push_back({std::to_string(task.candidate.from), std::to_string(task.candidate.to)});
  }
  line["pairs"] = std::move(pairs);
  return finish(std::move(line), a);
}

std::string result_line(double time_s, const RegistrationResult& result, const CandidateAccounting& a) {
  Json line = new_line("result", time_s);
  put_result(line, result);
  return finish(std::move(line), a);
}

std::string live_result_line(double time_s, const RegistrationResult& result,
                             const ModuleStatistics& statistics) {
  Json line = new_line("result", time_s);
  put_result(line, result);
  line["queues"] = {{"events", statistics.events_waiting},
                    {"producer_waits", statistics.producer_waits},
                    {"overdue", statistics.overdue_now}};
  return finish(std::move(line), statistics.candidates);
}

std::string estimate_line(double time_s, const GncResult& gnc, const CandidateAccounting& a) {
  Json line = new_line("estimate", time_s);
  line["cost"] = gnc.optimization.cost;
  line["inliers"] = gnc.inliers;
  line["outliers"] = gnc.outliers;
  line["outer_iterations"] = gnc.outer_iterations;
  line["start"] = enum_name(gnc.start);
  line["converged"] = gnc.optimization.converged;
  return finish(std::move(line), a);
}

std::string end_line(double time_s, bool interrupted, const CandidateAccounting& a) {
  Json line = new_line("end", time_s);
  line["interrupted"] = interrupted;
  return finish(std::move(line), a);
}

}  // namespace journal

}  // namespace loopwise
