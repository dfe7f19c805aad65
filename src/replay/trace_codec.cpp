// SPDX-License-Identifier: BSD-3-Clause
#include "trace_codec.hpp"

#include <cstring>
#include <limits>
#include <utility>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/trace.hpp>

#include "outcome_json.hpp"

namespace loopwise {
namespace {

constexpr int kFormat = 1;

// ---- values

Json key_json(Key key) {
  return std::to_string(key);
}
Key key_from(const Json& json, const char* name) {
  return parse_key(json.at(name).get<std::string>());
}

std::uint64_t whole_from(const Json& json, const char* name) {
  return detail::json_to_uint64(json.at(name), name, std::numeric_limits<std::uint64_t>::max());
}
std::int64_t stamp_from(const Json& json) {
  using Limits = std::numeric_limits<std::int64_t>;
  return detail::json_to_int64(json.at("stamp_ns"), "stamp_ns", Limits::min(), Limits::max());
}

/// Hexadecimal text with eight digits per word.
std::string hex(const std::vector<std::uint32_t>& words) {
  std::string text;
  text.reserve(8 * words.size());
  for (const std::uint32_t word : words) {
    for (int shift = 28; shift >= 0; shift -= 4) text += "0123456789abcdef"[(word >> shift) & 0xFU];
  }
  return text;
}
std::vector<std::uint32_t> words_from(const std::string& text) {
  if (text.size() % 8 != 0) throw InputError("a scan's signature is cut short");
  std::vector<std::uint32_t> words(text.size() / 8, 0);
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char* const digits = "0123456789abcdef";
    const char* const digit = std::strchr(digits, text[i]);
    if (digit == nullptr || *digit == '\0')
      throw InputError("a scan's signature has a character that is not a hexadecimal digit");
    words[i / 8] = words[i / 8] << 4U | static_cast<std::uint32_t>(digit - digits);
  }
  return words;
}

Json pose_json(const Eigen::Isometry3d& pose) {
  return numbers(pose.matrix().topRows<3>());
}
Eigen::Isometry3d pose_from(const Json& json, const char* name) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.affine() = matrix_of<Eigen::Matrix<double, 3, 4>>(json.at(name));
  return pose;
}

template <class T, class Write>
Json list_json(const std::vector<T>& list, Write&& write) {
  Json out = Json::array();
  for (const T& item : list) out.push_back(write(item));
  return out;
}
template <class T, class Read>
std::vector<T> list_from(const Json& json, const char* name, Read&& read) {
  std::vector<T> out;
  const auto found = json.find(name);
  if (found == json.end()) return out;
  for (const Json& item : *found) out.push_back(read(item));
  return out;
}

Json between_json(const BetweenFactor& f) {
  return {{"from", key_json(f.from)},
          {"to", key_json(f.to)},
          {"T_from_to", pose_json(f.T_from_to)},
          {"information", numbers(f.information)},
          {"trusted", f.trusted}};
}
BetweenFactor between_from(const Json& json) {
  return {key_from(json, "from"), key_from(json, "to"), pose_from(json, "T_from_to"),
          matrix_of<Matrix6d>(json.at("information")), json.at("trusted").get<bool>()};
}

Json prior_json(const PriorFactor& f) {
  return {{"key", key_json(f.key)}, {"pose", pose_json(f.pose)}, {"information", numbers(f.information)}};
}
PriorFactor prior_from(const Json& json) {
  return {key_from(json, "key"), pose_from(json, "pose"), matrix_of<Matrix6d>(json.at("information"))};
}

Json range_json(const RangeFactor& f) {
  return {{"from", key_json(f.from)}, {"to", key_json(f.to)}, {"range_m", f.range_m}, {"sigma_m", f.sigma_m}};
}
RangeFactor range_from(const Json& json) {
  return {key_from(json, "from"), key_from(json, "to"), json.at("range_m").get<double>(),
          json.at("sigma_m").get<double>()};
}

Json gravity_json(const GravityFactor& f) {
  return {{"key", key_json(f.key)},
          {"direction", numbers(f.direction)},
          {"sigma_rad", f.sigma_rad},
          {"reference", numbers(f.reference)}};
}
GravityFactor gravity_from(const Json& json) {
  return {key_from(json, "key"), matrix_of<Eigen::Vector3d>(json.at("direction")),
          json.at("sigma_rad").get<double>(), matrix_of<Eigen::Vector3d>(json.at("reference"))};
}

Json candidate_json(const LoopCandidate& c) {
  Json json = {{"id", c.id},           {"from", key_json(c.from)},
               {"to", key_json(c.to)}, {"source", enum_name(c.source)},
               {"time_s", c.time_s},   {"distance_m", c.distance_m}};
  if (!c.recognition) return json;
  json["similarity"] = c.recognition->similarity;
  if (!c.recognition->T_from_to) return json;
  json["pose"] = pose_json(*c.recognition->T_from_to);
  json["covariance"] = numbers(c.recognition->covariance);
  return json;
}
LoopCandidate candidate_from(const Json& json) {
  LoopCandidate candidate{whole_from(json, "id"),
                          key_from(json, "from"),
                          key_from(json, "to"),
                          parse_enum<CandidateSource>("source", json.at("source").get<std::string>()),
                          number_or_nan(json.at("time_s")),
                          number_or_nan(json.at("distance_m")),
                          nullptr};
  if (!json.contains("similarity")) return candidate;
  auto recognition = std::make_shared<Recognition>();
  recognition->similarity = number_or_nan(json.at("similarity"));
  if (json.contains("pose")) {
    recognition->T_from_to = pose_from(json, "pose");
    recognition->covariance = matrix_of<Matrix6d>(json.at("covariance"));
  }
  candidate.recognition = std::move(recognition);
  return candidate;
}

Json reading_json(const RadioReading& r) {
  return {{"key", key_json(r.key)},
          {"beacon", r.beacon},
          {"transmit_dbm", r.transmit_dbm},
          {"receiver", r.receiver},
          {"receive_dbm", r.receive_dbm}};
}
RadioReading reading_from(const Json& json) {
  return {key_from(json, "key"), json.at("beacon").get<std::string>(), number_or_nan(json.at("transmit_dbm")),
          json.at("receiver").get<std::string>(), number_or_nan(json.at("receive_dbm"))};
}

/// Writes the lists of a KeyFrame or of Factors; empty lists are left out.
template <class Source>
void put_factors(Json& line, const Source& source) {
  const auto put = [&line](const char* name, Json list) {
    if (!list.empty()) line[name] = std::move(list);
  };
  put("odometry", list_json(source.odometry, between_json));
  put("closures", list_json(source.closures, between_json));
  put("landmarks", list_json(source.landmarks, between_json));
  put("priors", list_json(source.priors, prior_json));
  put("ranges", list_json(source.ranges, range_json));
  put("gravities", list_json(source.gravities, gravity_json));
}
template <class Source>
void take_factors(const Json& line, Source& source) {
  source.odometry = list_from<BetweenFactor>(line, "odometry", between_from);
  source.closures = list_from<BetweenFactor>(line, "closures", between_from);
  source.landmarks = list_from<BetweenFactor>(line, "landmarks", between_from);
  source.priors = list_from<PriorFactor>(line, "priors", prior_from);
  source.ranges = list_from<RangeFactor>(line, "ranges", range_from);
  source.gravities = list_from<GravityFactor>(line, "gravities", gravity_from);
}

// ---- events: a name and the contents

struct Encoder {
  Json& line;

  void operator()(const KeyFrame& frame) const {
    line["event"] = "key_frame";
    line["key"] = key_json(frame.node.key);
    line["pose"] = pose_json(frame.node.pose);
    line["stamp_ns"] = frame.node.stamp_ns;
    if (frame.cloud) line["scan"] = true;
    put_factors(line, frame);
  }
  void operator()(const Factors& factors) const {
    line["event"] = "factors";
    put_factors(line, factors);
  }
  void operator()(const event::Scan& event) const {
    line["event"] = "scan";
    line["key"] = key_json(event.scan.key);
  }
  void operator()(const event::Radio& event) const {
    line["event"] = "radio";
    line["readings"] = list_json(event.readings, reading_json);
  }
  void operator()(const BeaconDrop& drop) const {
    line["event"] = "beacon_drop";
    line["beacon"] = drop.beacon;
    line["robot"] = drop.robot;
    line["drop_key"] = key_json(drop.drop_key);
    line["stamp_ns"] = drop.stamp_ns;
  }
  void operator()(const event::Candidates& event) const {
    line["event"] = "candidates";
    line["candidates"] = list_json(event.candidates, candidate_json);
  }
  void operator()(const RegistrationResult& result) const {
    line["event"] = "result";
    line["id"] = result.candidate.id;
    line["outcome"] = outcome_json(result);
  }
  void operator()(const event::BatchDone& event) const {
    line["event"] = "batch_done";
    line["not_computed"] = list_json(event.not_computed, candidate_json);
  }
  void operator()(const event::Optimized& event) const {
    line["event"] = "optimized";
    line["stopped"] = event.stopped;
    line["failure"] = event.failure;
    if (!event.stopped && event.failure.empty()) line["estimate"] = estimate_hash(event.gnc);
  }
  void operator()(const ExternalEstimate& estimate) const {
    line["event"] = "external_estimate";
    line["poses"] = Json::array();
    for (const auto& [key, pose] : estimate.poses) {
      line["poses"].push_back({{"key", key_json(key)}, {"pose", pose_json(pose)}});
    }
    line["covariances"] = Json::array();
    for (const auto& [key, covariance] : estimate.covariances) {
      line["covariances"].push_back({{"key", key_json(key)}, {"covariance", numbers(covariance)}});
    }
  }
  void operator()(const ClosureDecision& decision) const {
    line["event"] = "closure_decision";
    line["from"] = key_json(decision.from);
    line["to"] = key_json(decision.to);
    line["accepted"] = decision.accepted;
  }
  void operator()(const event::Tick&) const { line["event"] = "tick"; }
  void operator()(const event::Improve& event) const {
    line["event"] = "improve";
    line["count"] = event.count;
    line["max_evaluations"] = event.max_evaluations;
  }
  void operator()(const event::Choose& event) const {
    line["event"] = "choose";
    line["count"] = event.count;
  }
  void operator()(const event::Settle& settle) const {
    line["event"] = "settle";
    if (settle.last) line["last"] = true;
  }
  void operator()(const event::NoMoreScans&) const { line["event"] = "no_more_scans"; }
};

std::shared_ptr<const PointCloud> empty_cloud() {
  static const auto cloud = std::make_shared<const PointCloud>();
  return cloud;
}

KeyFrame key_frame_from(const Json& line) {
  KeyFrame frame;
  frame.node.key = key_from(line, "key");
  frame.node.pose = pose_from(line, "pose");
  frame.node.stamp_ns = stamp_from(line);
  if (line.contains("scan")) frame.cloud = empty_cloud();
  take_factors(line, frame);
  return frame;
}

ExternalEstimate external_estimate_from(const Json& line) {
  ExternalEstimate estimate;
  for (const Json& item : line.at("poses")) estimate.poses[key_from(item, "key")] = pose_from(item, "pose");
  for (const Json& item : line.at("covariances")) {
    estimate.covariances[key_from(item, "key")] = matrix_of<Matrix6d>(item.at("covariance"));
  }
  return estimate;
}

Event event_from(const Json& line) {
  const std::string name = line.at("event").get<std::string>();
  if (name == "key_frame") return key_frame_from(line);
  if (name == "factors") {
    Factors factors;
    take_factors(line, factors);
    return factors;
  }
  if (name == "scan") return event::Scan{{key_from(line, "key"), 0, empty_cloud()}};
  if (name == "radio") return event::Radio{list_from<RadioReading>(line, "readings", reading_from)};
  if (name == "beacon_drop") {
    return BeaconDrop{line.at("beacon").get<std::string>(), whole_from(line, "robot"),
                      key_from(line, "drop_key"), stamp_from(line)};
  }
  if (name == "candidates") {
    return event::Candidates{list_from<LoopCandidate>(line, "candidates", candidate_from)};
  }
  if (name == "result") {
    RegistrationResult result = outcome_from(line.at("outcome"), /*any_numbers=*/true);
    result.candidate.id = whole_from(line, "id");
    return result;
  }
  if (name == "batch_done") {
    return event::BatchDone{list_from<LoopCandidate>(line, "not_computed", candidate_from)};
  }
  if (name == "optimized") {
    event::Optimized optimized;
    optimized.stopped = line.at("stopped").get<bool>();
    optimized.failure = line.at("failure").get<std::string>();
    return optimized;
  }
  if (name == "external_estimate") return external_estimate_from(line);
  if (name == "closure_decision") {
    return ClosureDecision{key_from(line, "from"), key_from(line, "to"), line.at("accepted").get<bool>()};
  }
  if (name == "tick") return event::Tick{};
  if (name == "improve") {
    return event::Improve{whole_from(line, "count"),
                          {},
                          list_from<std::uint64_t>(line, "max_evaluations", [](const Json& most) {
                            return detail::json_to_uint64(most, "max_evaluations",
                                                          std::numeric_limits<std::uint64_t>::max());
                          })};
  }
  if (name == "choose") return event::Choose{whole_from(line, "count")};
  if (name == "settle") return event::Settle{line.value("last", false)};
  if (name == "no_more_scans") return event::NoMoreScans{};
  throw InputError("unknown event \"" + name + "\"");
}

/// Visits the options whose effects are not already visible in the events.
template <class Options, class Visitor>
void visit_traced_sections(Options& options, Visitor&& visitor) {
  EngineOptions::visit_sections(options.engine, visitor);
  PrioritizationOptions::visit_sections(options.prioritization, visitor);
  BackEndOptions::visit_sections(options.back_end, visitor);
}

template <class Function>
auto with_json_errors(Function&& function) {
  try {
    return function();
  } catch (const Json::exception& error) {
    throw InputError(error.what());
  }
}

}  // namespace

std::string estimate_hash(const GncResult& gnc) {
  ContentHasher hasher;
  for (const Eigen::Isometry3d& pose : gnc.optimization.poses) {
    for (const double value : pose.matrix().reshaped()) hasher.number(value);
  }
  for (const double weight : gnc.weights) hasher.number(weight);
  return to_string(hasher.finish());
}

TraceWriter::TraceWriter(const Robots& robots, const ModuleOptions& options,
                         std::function<void(const std::string& line)> line)
    : line_(std::move(line)) {
  Json header = Json::object();
  header["trace"] = kFormat;
  header["code"] = replay_code_version();
  header["robots"] = list_json(robots.all(), [](const Robot& robot) {
    return Json{{"name", robot.name},
                {"first", key_json(robot.first)},
                {"last", key_json(robot.last)},
                {"landmarks", robot.landmarks}};
  });
  header["options"] = Json::object();
  visit_traced_sections(options, [&header](const char* name, const auto& section) {
    header["options"][name] = to_json(section);
  });
  line_(json_text(header));
}

void TraceWriter::add(const HandledEvent& handled) {
  Json line = Json::object();
  line["now_s"] = handled.now_s;
  std::visit(Encoder{line}, handled.event);
  if (handled.observability) line["observability"] = *handled.observability;
  if (handled.signature) line["signature"] = hex(handled.signature->words());
  if (broken_) throw InputError("the trace has ended: an earlier line could not be written");
  broken_ = true;  // until the line is written: a trace may end early, but has no gaps
  try {
    line_(line.dump());
  } catch (const Json::exception&) {
    throw InputError("a name in an event is not UTF-8: the trace ends before it");
  }
  broken_ = false;
}

TraceHeader parse_trace_header(const std::string& line) {
  return with_json_errors([&] {
    const Json json = parse_json(line, "trace");
    if (!json.is_object() || !json.contains("trace")) throw InputError("not a trace of the online module");
    if (json["trace"] != kFormat) {
      throw InputError("a trace of format " + json_text(json["trace"]) + ", this version reads " +
                       std::to_string(kFormat));
    }
    TraceHeader header;
    header.code = json.at("code").get<std::string>();
    header.robots = Robots(list_from<Robot>(json, "robots", [](const Json& robot) {
      return Robot{robot.at("name").get<std::string>(), key_from(robot, "first"), key_from(robot, "last"),
                   robot.at("landmarks").get<bool>()};
    }));
    const Json& options = json.at("options");
    visit_traced_sections(header.options, [&options](const char* name, auto& section) {
      apply_json(options.at(name), name, section);
    });
    return header;
  });
}

TraceEvent parse_trace_event(const std::string& line) {
  return with_json_errors([&] {
    const Json json = parse_json(line, "trace");
    if (!json.is_object()) throw InputError("expected an object");
    TraceEvent out;
    out.now_s = json.at("now_s").get<double>();
    out.event = event_from(json);
    if (json.contains("observability")) out.observability = json["observability"].get<double>();
    if (json.contains("signature")) {
      out.signature = ScanSignature::from_words(words_from(json["signature"].get<std::string>()));
    }
    if (json.contains("estimate")) out.estimate_hash = json["estimate"].get<std::string>();
    return out;
  });
}

}  // namespace loopwise
