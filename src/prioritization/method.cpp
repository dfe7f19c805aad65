// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/prioritization/method.hpp>

#include <algorithm>
#include <set>

#include <loopwise/core/error.hpp>
#include <loopwise/core/names.hpp>
#include <loopwise/core/random.hpp>
#include <loopwise/prioritization/baselines.hpp>
#include <loopwise/prioritization/rssi.hpp>

namespace loopwise {
namespace {

const Method kFull{PrioritizerKind::kObservability, PrioritizerKind::kGraphInformation};

}  // namespace

std::vector<std::string> method_names() {
  return {"odom", "baseline", "random", "obs", "gi", "full", "rssi", "likely", "expected"};
}

Method parse_method(std::string_view text) {
  if (text == "odom") return {};
  std::set<PrioritizerKind> asked;
  for (std::size_t begin = 0; begin <= text.size();) {
    const std::size_t end = std::min(text.find('+', begin), text.size());
    const std::string_view word = text.substr(begin, end - begin);
    if (word.empty()) throw OptionError("method \"" + std::string(text) + "\": a name is missing");
    const std::vector<std::string> names = method_names();
    if (word == "odom" || std::find(names.begin(), names.end(), word) == names.end()) {
      throw_unknown_name("method", text, names);
    }
    if (word == "full") {
      asked.insert(kFull.begin(), kFull.end());
    } else {
      asked.insert(parse_enum<PrioritizerKind>("method", word));
    }
    begin = end + 1;
  }
  return {asked.begin(), asked.end()};
}

std::string to_string(const Method& method) {
  if (method.empty()) return "odom";
  if (method == kFull) return "full";
  std::string text;
  for (const PrioritizerKind kind : method) text += (text.empty() ? "" : "+") + enum_name(kind);
  return text;
}

bool uses_radio(const Method& method) {
  return std::find(method.begin(), method.end(), PrioritizerKind::kRssi) != method.end();
}

std::vector<std::unique_ptr<Prioritizer>> make_prioritizers(const PrioritizationOptions& options,
                                                            std::uint64_t seed, const Robots& robots,
                                                            const ScanInsight& scans) {
  if (std::set<PrioritizerKind>(options.method.begin(), options.method.end()).size() !=
      options.method.size()) {
    throw OptionError("method \"" + to_string(options.method) + "\": a prioritiser is named twice");
  }
  const auto make = [&](PrioritizerKind kind) -> std::unique_ptr<Prioritizer> {
    switch (kind) {
      case PrioritizerKind::kArrival:
        return std::make_unique<ArrivalPrioritizer>();
      case PrioritizerKind::kRandom:
        return std::make_unique<RandomPrioritizer>(seed);
      case PrioritizerKind::kObservability:
        return std::make_unique<ObservabilityPrioritizer>(options.observability, robots, scans.eigenvalue);
      case PrioritizerKind::kGraphInformation: {
        GraphInformationOptions gi = options.graph_information;
        gi.seed = combine_seeds(seed, gi.seed);
        return std::make_unique<GraphInformationPrioritizer>(gi, options.closure_model, options.annealing,
                                                             options.greedy);
      }
      case PrioritizerKind::kLikely:
      case PrioritizerKind::kExpected: {
        ExpectedOptions expected = options.expected;
        if (kind == PrioritizerKind::kLikely) expected.gain_exponent = 0.0;
        return std::make_unique<ExpectedPrioritizer>(expected, options.closure_model, robots, scans.signature,
                                                     seed, enum_name(kind));
      }
      case PrioritizerKind::kRssi:
        break;
    }
    return std::make_unique<RssiPrioritizer>();
  };
  std::vector<std::unique_ptr<Prioritizer>> prioritizers;
  for (const PrioritizerKind kind : options.method) prioritizers.push_back(make(kind));
  return prioritizers;
}

}  // namespace loopwise
