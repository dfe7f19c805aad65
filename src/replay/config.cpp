// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/config.hpp>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise {
namespace {

std::vector<std::string> section_names(const Config& config) {
  std::vector<std::string> names;
  Config::visit_sections(config, [&names](const char* name, const auto&) { names.emplace_back(name); });
  return names;
}

/// Calls visit(section) for the section with this name. \throws OptionError if there is no such section.
template <class Visitor>
void with_section(Config& config, const std::string& name, Visitor&& visit) {
  bool found = false;
  Config::visit_sections(config, [&](const char* own, auto& section) {
    if (name != own) return;
    found = true;
    visit(section);
  });
  if (!found) throw_unknown_name("section", name, section_names(config));
}

template <class Sections>
std::string sections_json(const Sections& sections) {
  Json all = Json::object();
  Sections::visit_sections(sections,
                           [&all](const char* name, const auto& section) { all[name] = to_json(section); });
  return all.dump(2) + "\n";
}

/// Keys of earlier versions, with the keys that replaced them.
const std::map<std::string, std::string>& renamed_keys() {
  static const std::map<std::string, std::string> keys{
      {"replay.method", "prioritization.method"},
      {"replay.registration_time_s", "cost.registration_time_s"},
      {"replay.measured_time", "cost.measured_time"},
      {"replay.workers", "cost.workers"},
      {"replay.gi_evaluation_time_s", "cost.gi_evaluation_time_s"},
      {"replay.thin", "engine.thin"},
      {"replay.guess", "engine.guess"},
      {"replay.seed", "engine.seed"},
      {"replay.registrar", "registration.registrar"},
      {"closure_model.holding", "closure_model.storage"},
      {"optimization.num_threads", "optimization.threads"},
      {"closure_model.num_threads", "closure_model.threads"},
      {"fast_registrar.max_rotation_deg", "fast_registrar.max_rotation_rad (50 degrees are 0.8727 rad)"},
      {"pcl_registrar.max_rotation_deg", "pcl_registrar.max_rotation_rad (50 degrees are 0.8727 rad)"},
  };
  return keys;
}

/// \throws OptionError for a key of an earlier version
void refuse_renamed(const std::string& section, const std::string& key) {
  const std::string name = section + "." + key;
  if (name == "graph_information.acceptance") {
    throw OptionError("unknown option " + name +
                      ": it was removed; gi counts every candidate as a closure, the methods expected and "
                      "likely use its probability");
  }
  const auto found = renamed_keys().find(name);
  if (found == renamed_keys().end()) return;
  throw OptionError("unknown option " + found->first + ": it is now called " + found->second);
}

}  // namespace

std::size_t batch_size(const ReplayOptions& options) {
  constexpr double kBatch_s =
      13.0;  // 100 registrations on the paper's laptop, which the cost model describes
  constexpr double kMost = 100.0;
  if (options.batch > 0) return static_cast<std::size_t>(options.batch);
  if (options.cost.measured_time) return static_cast<std::size_t>(kMost);
  const auto workers = static_cast<double>(options.cost.workers);
  const double turns = std::max(1.0, std::floor(kBatch_s / options.cost.registration_time_s));
  return static_cast<std::size_t>(std::max(workers, std::min(turns * workers, kMost)));
}

void validate_replay(const ReplayOptions& options) {
  validate_sections(options);
  try {
    validate_proximity(options.engine.generation);
  } catch (const OptionError& error) {
    throw OptionError(std::string("generation.") + error.what());
  }
  const ExpectedOptions& expected = options.prioritization.expected;
  for (const auto& [weights, name] : {std::pair(&expected.verified_weights, "expected.verified_weights"),
                                      std::pair(&expected.right_weights, "expected.right_weights")}) {
    if (!weights->empty()) static_cast<void>(AcceptanceModel::parse(*weights, name));
  }
  if (options.cost.measured_time && options.cost.refused_time_share != 1.0) {
    throw OptionError(
        "cost.refused_time_share models the time of refused registrations, cost.measured_time measures it: "
        "give one of them");
  }
}

void validate_config(const Config& config) {
  validate_sections(config);
  validate_replay(config.replay);
}

namespace {

void apply_file(const Json& file, const std::string& source, Config& config) {
  Config changed = config;
  try {
    if (!file.is_object()) throw OptionError("expected an object of sections");
    for (const auto& item : file.items()) {
      const std::string& name = item.key();
      Json section_json = item.value();
      if (name == "generation" && section_json.is_object() && section_json.contains("preset")) {
        if (!section_json["preset"].is_string()) throw OptionError("generation.preset must be a word");
        changed.replay.engine.generation = proximity_preset(section_json["preset"].get<std::string>());
        section_json.erase("preset");
      }
      if (section_json.is_object()) {
        for (const auto& field : section_json.items()) refuse_renamed(name, field.key());
      }
      with_section(changed, name, [&](auto& section) { apply_json(section_json, name, section); });
    }
    validate_config(changed);
  } catch (const OptionError& error) {
    throw OptionError(source + ": " + error.what());
  }
  config = changed;
}

}  // namespace

void read_config(const std::filesystem::path& path, Config& config) {
  apply_file(read_json_file(path), path.string(), config);
}

void parse_config(std::string_view json, const std::string& source, Config& config) {
  apply_file(parse_json(json, source), source, config);
}

void set_config_option(const std::string& assignment, Config& config) {
  const std::size_t equals = assignment.find('='), dot = assignment.find('.');
  if (equals == std::string::npos || dot == std::string::npos || dot > equals) {
    throw OptionError("\"" + assignment +
                      "\": expected SECTION.FIELD=VALUE, for example generation.rate_m=0.3");
  }
  const std::string section_name = assignment.substr(0, dot);
  const std::string field = assignment.substr(dot + 1, equals - dot - 1);
  const std::string value = assignment.substr(equals + 1);
  if (section_name == "generation" && field == "preset") {
    config.replay.engine.generation = proximity_preset(value);
    return;
  }
  refuse_renamed(section_name, field);
  with_section(config, section_name, [&](auto& section) { set_option(section_name, field, value, section); });
}

std::string config_json(const Config& config) {
  return sections_json(config);
}

std::string options_json(const ReplayOptions& options) {
  return sections_json(options);
}

namespace {

/// A line with the hash of a file's content; empty if no file is named.
std::string content_key(const std::string& option, const std::string& path) {
  if (path.empty()) return {};
  ContentHasher hasher;
  std::ifstream in(path, std::ios::binary);
  std::string piece(1 << 16, '\0');
  while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())) || in.gcount() > 0) {
    hasher.bytes(piece.data(), static_cast<std::size_t>(in.gcount()));
  }
  return option + " " + (in.eof() ? to_string(hasher.finish()) : "unreadable") + "\n";
}

}  // namespace

std::string options_key(const ReplayOptions& options) {
  return options_json(options) +
         content_key("gnn_weights", options.prioritization.graph_information.gnn_weights) +
         content_key("candidates", options.candidates) + content_key("decisions", options.decisions);
}

std::string config_key(const Config& config) {
  return json_text(to_json(config.mission)) + options_key(config.replay);
}

std::vector<ConfigEntry> describe_config(const Config& config) {
  std::vector<ConfigEntry> entries;
  Config::visit_sections(config, [&entries](const char* name, const auto& section) {
    for (const OptionDescription& option : describe(section)) {
      entries.push_back({std::string(name) + "." + option.name, option.type, option.default_value,
                         option.bounds, option.doc});
    }
  });
  return entries;
}

}  // namespace loopwise
