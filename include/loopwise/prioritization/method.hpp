// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Methods by name: the prioritisers that order the candidates.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/prioritization/covariance_objective.hpp>
#include <loopwise/prioritization/expected.hpp>
#include <loopwise/prioritization/graph_information.hpp>
#include <loopwise/prioritization/observability.hpp>
#include <loopwise/prioritization/prioritizer.hpp>
#include <loopwise/prioritization/selection.hpp>

namespace loopwise {

/// The prioritisers of methods.
enum class PrioritizerKind {
  kArrival,           ///< ArrivalPrioritizer, the paper's Bsln.
  kRandom,            ///< RandomPrioritizer, the paper's Rand.
  kObservability,     ///< ObservabilityPrioritizer
  kGraphInformation,  ///< GraphInformationPrioritizer
  kRssi,              ///< RssiPrioritizer
  kLikely,            ///< ExpectedPrioritizer, by the probability alone.
  kExpected,          ///< ExpectedPrioritizer
};
[[nodiscard]] inline EnumNames<PrioritizerKind> enum_names(PrioritizerKind) {
  return {{PrioritizerKind::kArrival, "baseline"},  {PrioritizerKind::kRandom, "random"},
          {PrioritizerKind::kObservability, "obs"}, {PrioritizerKind::kGraphInformation, "gi"},
          {PrioritizerKind::kRssi, "rssi"},         {PrioritizerKind::kLikely, "likely"},
          {PrioritizerKind::kExpected, "expected"}};
}

/// Prioritisers in the order of their turns. If empty, no candidate is computed.
using Method = std::vector<PrioritizerKind>;

/// The names that parse_method() knows: those of the prioritisers, "full" (obs and gi) and "odom" (none).
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::string> method_names();

/// One name, or several joined by "+", as "gi+rssi". The turns are in the order of PrioritizerKind.
/// \throws OptionError that lists the names
[[nodiscard]] LOOPWISE_EXPORT Method parse_method(std::string_view text);

/// The text for parse_method(): "full", "obs+rssi", "odom".
[[nodiscard]] LOOPWISE_EXPORT std::string to_string(const Method& method);

/// Whether the method uses candidates of radio beacons.
[[nodiscard]] LOOPWISE_EXPORT bool uses_radio(const Method& method);

/// Reads an option that is a method, see core/options.hpp. \throws OptionError
inline void parse_option(std::string_view /*name*/, std::string_view text, Method& method) {
  method = parse_method(text);
}
/// The text of an option that is a method, see core/options.hpp.
[[nodiscard]] inline std::string option_text(const Method& method) {
  return to_string(method);
}

/// The method and the options of its prioritisers.
struct PrioritizationOptions {
  /// Method that orders the candidates: expected, likely, odom (no closures), baseline, random, obs, gi, full
  /// (obs and gi), rssi, or several of them joined by +.
  Method method = {PrioritizerKind::kExpected};
  ExpectedOptions expected;                    ///< Of `expected` and `likely`.
  ObservabilityPriorityOptions observability;  ///< Of `obs`.
  GraphInformationOptions graph_information;   ///< Of `gi`.
  ClosureModelOptions closure_model;           ///< Model of a candidate's closure for `gi` and `expected`.
  AnnealingOptions annealing;                  ///< Simulated annealing of `gi`.
  GreedyOptions greedy;                        ///< Greedy choice of `gi`.

  /// Calls visitor(name, section) for these options and those of the prioritisers.
  template <class Self, class Visitor>
  static void visit_sections(Self& self, Visitor&& visitor) {
    visitor("prioritization", self);
    visitor("expected", self.expected);
    visitor("observability", self.observability);
    visitor("graph_information", self.graph_information);
    visitor("closure_model", self.closure_model);
    visitor("annealing", self.annealing);
    visitor("greedy", self.greedy);
  }

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("method", self.method, any_value());
  }
};

/// Functions that describe a scan to the prioritisers. Each is called at most once for a scan.
struct ScanInsight {
  ObservabilityPrioritizer::Eigenvalue eigenvalue;  ///< For `obs`; may be empty for other methods.
  ExpectedPrioritizer::Signature signature;         ///< For `expected` and `likely`; may be empty.
};

/// The prioritisers of a method, in the order of their turns.
/// \param options the method and its prioritisers' options
/// \param seed of all random draws
/// \param robots whose nodes the candidates join
/// \param scans describes scans to the prioritisers
/// \throws OptionError if a prioritiser is named twice, or on its options
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::unique_ptr<Prioritizer>> make_prioritizers(
    const PrioritizationOptions& options, std::uint64_t seed, const Robots& robots, const ScanInsight& scans);

}  // namespace loopwise
