// SPDX-License-Identifier: BSD-3-Clause
#include "run_journal.hpp"

#include <algorithm>
#include <fstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

using UnorderedJson = nlohmann::json;

/// The first value of a line, which is the event. Lines are long, and most are not needed here.
std::string event_name(const std::string& line) {
  const std::size_t colon = line.find(":\"");
  if (colon == std::string::npos) return {};
  const std::size_t begin = colon + 2, end = line.find('"', begin);
  return end == std::string::npos ? std::string() : line.substr(begin, end - begin);
}

/// 0 if there is no count of that name.
std::uint64_t count(const UnorderedJson& in, const char* name) {
  const auto found = in.find(name);
  return found != in.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

void add_candidates(RunJournal& journal, const UnorderedJson& event) {
  const auto pairs = event.find("pairs");
  if (pairs == event.end() || !pairs->is_array()) return;
  for (const UnorderedJson& pair : *pairs) {
    if (!pair.is_array() || pair.size() != 2 || !pair[0].is_string() || !pair[1].is_string()) continue;
    journal.candidates.emplace_back(parse_key(pair[0].get_ref<const std::string&>()),
                                    parse_key(pair[1].get_ref<const std::string&>()));
  }
}

void add_moment(RunJournal& journal, const UnorderedJson& event, std::uint64_t inliers) {
  const auto account = event.find("account"), time = event.find("time_s");
  if (account == event.end() || !account->is_object() || time == event.end() || !time->is_number()) return;
  const std::uint64_t generated = count(*account, "generated");
  const RunJournal::Moment moment{time->get<double>(), generated,
                                  generated - std::min(generated, count(*account, "pruned")),
                                  count(*account, "computed"), inliers};
  auto& moments = journal.moments;
  if (!moments.empty() && moments.back().time_s == moment.time_s) {
    moments.back() = moment;
  } else {
    moments.push_back(moment);
  }
}

}  // namespace

RunJournal parse_run_journal(std::istream& in, const std::string& name) {
  RunJournal journal;
  std::uint64_t inliers = 0;
  std::string line;
  for (std::size_t number = 1; std::getline(in, line); ++number) {
    const std::string event = event_name(line);
    if (event != "batch" && event != "estimate" && event != "end") continue;
    const UnorderedJson json = UnorderedJson::parse(line, nullptr, false);
    const auto said = json.find("event");
    if (!json.is_object() || said == json.end() || *said != event) continue;
    if (event == "estimate") inliers = count(json, "inliers");
    add_moment(journal, json, inliers);
    try {
      if (event == "batch") add_candidates(journal, json);
    } catch (const InputError& error) {
      throw ParseError(name, number, error.what());
    }
  }
  if (in.bad()) throw IoError(name, "cannot be read");
  return journal;
}

RunJournal read_run_journal(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) throw IoError(path.string(), "cannot be opened");
  return parse_run_journal(in, path.string());
}

}  // namespace loopwise
