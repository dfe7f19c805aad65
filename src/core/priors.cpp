// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/core/priors.hpp>

#include <charconv>
#include <cmath>
#include <vector>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

double positive_number(const std::string& name, const std::string& text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !(value > 0.0) || !std::isfinite(value)) {
    throw OptionError(name + ": \"" + text + "\" is not a positive number");
  }
  return value;
}

std::vector<std::string> split_at_colons(const std::string& text) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  for (std::size_t colon = text.find(':'); colon != std::string::npos; colon = text.find(':', begin)) {
    parts.push_back(text.substr(begin, colon - begin));
    begin = colon + 1;
  }
  parts.push_back(text.substr(begin));
  return parts;
}

}  // namespace

PriorFactor prior_at(const PoseGraph& graph, Key key, double sigma_m, double sigma_rad) {
  PriorFactor prior;
  prior.key = key;
  prior.pose = graph.node(key).pose;
  prior.information.setZero();
  prior.information.diagonal() << Eigen::Vector3d::Constant(1.0 / (sigma_m * sigma_m)),
      Eigen::Vector3d::Constant(1.0 / (sigma_rad * sigma_rad));
  return prior;
}

PriorFactor parse_prior(const std::string& name, const std::string& text, const PoseGraph& graph) {
  const std::vector<std::string> parts = split_at_colons(text);
  const std::string place = name + " " + text + ": ";
  if (parts.size() > 3) throw OptionError(place + "expected KEY[:sigma_m[:sigma_rad]]");
  Key key = 0;
  try {
    key = parse_key(parts[0]);
  } catch (const InputError& error) {
    throw OptionError(place + error.what());
  }
  if (!graph.contains(key)) throw OptionError(place + "the graph has no such node");
  return prior_at(graph, key, parts.size() > 1 ? positive_number(name, parts[1]) : kAnchorSigma,
                  parts.size() > 2 ? positive_number(name, parts[2]) : kAnchorSigma);
}

std::size_t anchor_components(PoseGraph& graph, double sigma_m, double sigma_rad) {
  const std::vector<std::size_t> component = connected_components(graph);
  std::size_t next = 0;
  for (std::size_t i = 0; i < component.size(); ++i) {
    if (component[i] != next) continue;
    ++next;
    graph.add_prior(prior_at(graph, graph.nodes()[i].key, sigma_m, sigma_rad));
  }
  return next;
}

}  // namespace loopwise
