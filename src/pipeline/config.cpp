// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/pipeline/config.hpp>

#include <algorithm>
#include <fstream>

#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/rssi.hpp>

namespace loopwise {
namespace {

std::vector<std::string> section_names(const Config& config) {
  std::vector<std::string> names;
  Config::visit_sections(config, [&names](const char* name, const auto&) { names.emplace_back(name); });
  return names;
}

/// Calls visit(section) for the section of this name. \throws OptionError if there is none.
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

/// A relation between fields of the section that bounds alone cannot state.
template <class Section>
void check_relations(const Section&, const std::string&) {}

template <>
void check_relations(const ProximityOptions& options, const std::string& section) {
  try {
    validate_proximity(options);
  } catch (const OptionError& error) {
    throw OptionError(section + "." + error.what());
  }
}

}  // namespace

void validate_config(const Config& config) {
  Config::visit_sections(config, [](const char* name, const auto& section) {
    try {
      validate(section);
    } catch (const OptionError& error) {
      throw OptionError(std::string(name) + "." + error.what());
    }
  });
  check_relations(config.generation, "generation");
  (void)method_parts(config.replay.method);
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
        changed.generation = proximity_preset(section_json["preset"].get<std::string>());
        section_json.erase("preset");
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
    config.generation = proximity_preset(value);
    return;
  }
  with_section(config, section_name, [&](auto& section) { set_option(section_name, field, value, section); });
}

std::string config_json(const Config& config) {
  Json all = Json::object();
  Config::visit_sections(config,
                         [&all](const char* name, const auto& section) { all[name] = to_json(section); });
  return all.dump(2) + "\n";
}

std::string config_key(const Config& config) {
  std::string key = config_json(config);
  const std::string& weights = config.graph_information.gnn_weights;
  if (weights.empty()) return key;
  ContentHasher hasher;
  std::ifstream in(weights, std::ios::binary);
  std::string piece(1 << 16, '\0');
  while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())) || in.gcount() > 0) {
    hasher.bytes(piece.data(), static_cast<std::size_t>(in.gcount()));
  }
  return key + "gnn_weights " + (in.eof() ? to_string(hasher.finish()) : "unreadable") + "\n";
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

std::vector<std::string> method_names() {
  return {"odom", "baseline", "random", "obs", "gi", "full", "rssi"};
}

std::vector<std::string> method_parts(const std::string& method) {
  if (method == "odom") return {};
  std::vector<std::string> asked;
  for (std::size_t begin = 0; begin <= method.size();) {
    const std::size_t end = std::min(method.find('+', begin), method.size());
    const std::string word = method.substr(begin, end - begin);
    const std::vector<std::string> names = method_names();
    if (word.empty()) throw OptionError("method \"" + method + "\": a name is missing");
    if (word == "odom" || std::find(names.begin(), names.end(), word) == names.end()) {
      throw_unknown_name("method", method, names);
    }
    if (word == "full") {
      asked.insert(asked.end(), {"obs", "gi"});
    } else {
      asked.push_back(word);
    }
    begin = end + 1;
  }
  std::vector<std::string> parts;
  for (const char* name : {"baseline", "random", "obs", "gi", "rssi"}) {
    if (std::find(asked.begin(), asked.end(), name) != asked.end()) parts.emplace_back(name);
  }
  return parts;
}

bool uses_radio(const std::string& method) {
  const std::vector<std::string> parts = method_parts(method);
  return std::find(parts.begin(), parts.end(), "rssi") != parts.end();
}

std::shared_ptr<const Registrar> make_registrar(RegistrarKind kind, const Config& config,
                                                std::shared_ptr<FeatureCache> features) {
  if (kind == RegistrarKind::kFast) {
    return std::make_shared<FastRegistrar>(std::move(features), config.fast_registrar);
  }
#ifdef LOOPWISE_WITH_PCL
  return std::make_shared<PclRegistrar>(std::move(features), config.pcl_registrar);
#else
  throw OptionError("registrar = \"pcl\": this build was made without PCL");
#endif
}

EngineOptions engine_options(const Config& config) {
  EngineOptions options;
  options.generation = config.generation;
  options.radio = config.radio;
  options.pool = config.pool;
  options.task = config.task;
  options.guess = config.replay.guess;
  options.thin = config.replay.thin;
  options.seed = config.replay.seed;
  return options;
}

ObservabilityPrioritizer::Eigenvalue observability_of(FeatureCache& features, ObservabilityVariant variant) {
  return [&features, variant](const KeyedScan& scan) {
    const auto of_scan = features.get(scan.key);
    if (!of_scan) return 0.0;
    return variant == ObservabilityVariant::kLamp ? of_scan->observability.min_eigenvalue_lamp
                                                  : of_scan->observability.min_eigenvalue;
  };
}

RoundRobinQueue make_queue(const Config& config, const Robots& robots,
                           const ObservabilityPrioritizer::Eigenvalue& eigenvalue) {
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  for (const std::string& part : method_parts(config.replay.method)) {
    if (part == "baseline") {
      prioritizers.push_back(std::make_unique<ArrivalPrioritizer>());
    } else if (part == "random") {
      prioritizers.push_back(std::make_unique<RandomPrioritizer>(config.replay.seed));
    } else if (part == "obs") {
      prioritizers.push_back(
          std::make_unique<ObservabilityPrioritizer>(config.observability, robots, eigenvalue));
    } else if (part == "gi") {
      GraphInformationOptions options = config.graph_information;
      options.seed = combine_seeds(config.replay.seed, options.seed);
      prioritizers.push_back(std::make_unique<GraphInformationPrioritizer>(options, config.closure_model,
                                                                           config.annealing, config.greedy));
    } else {
      prioritizers.push_back(std::make_unique<RssiPrioritizer>());
    }
  }
  return RoundRobinQueue(std::move(prioritizers));
}

}  // namespace loopwise
