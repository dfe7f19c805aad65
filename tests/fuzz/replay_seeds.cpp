// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>

#include <nlohmann/json.hpp>

#ifdef LOOPWISE_FUZZ_MPI
#include <loopwise/distributed/registration.hpp>
#endif
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/replay/config.hpp>
#include <loopwise/replay/outcome_store.hpp>
#include <loopwise/replay/replay.hpp>
#include <loopwise/replay/trace.hpp>
#include <loopwise/training/training_data.hpp>

#include "seeds.hpp"
#include "target.hpp"
#include "unit_file.hpp"

namespace loopwise::fuzz {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

RegistrationResult result(bool verified) {
  RegistrationResult out;
  out.candidate.from = 5;
  out.candidate.to = 3;
  out.T_from_to = Eigen::Isometry3d::Identity();
  out.reason = verified ? RejectionReason::kNone : RejectionReason::kLowOverlap;
  out.overlap = 0.75;
  if (!verified) out.message = "overlap 0.1 < 0.3";
  if (verified) {
    LoopClosure closure;
    closure.from = 5;
    closure.to = 3;
    closure.covariance = 0.01 * Matrix6d::Identity();
    out.closure = closure;
  }
  return out;
}

[[maybe_unused]] RegistrationTask task() {
  RegistrationTask out;
  out.candidate.from = 5;
  out.candidate.to = 3;
  out.guess_from_to = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d moved = Eigen::Isometry3d::Identity();
  moved.translation().x() = 1.0;
  out.source = {{5, Eigen::Isometry3d::Identity()}, {6, moved}};
  out.target = {{3, Eigen::Isometry3d::Identity()}};
  return out;
}

/// One number everywhere but where numbers must not repeat: enough for shapes.
Json tensor(std::size_t rows, std::size_t columns) {
  Json out;
  out["shape"] = rows == 0 ? Json::array({columns}) : Json::array({rows, columns});
  out["data"] = std::vector<double>(std::max<std::size_t>(rows, 1) * columns, 0.5);
  return out;
}

std::string small_effect_network() {
  constexpr std::size_t kM = 1, kK = 1, kH = 1;
  const auto shipped = Json::parse(read_file(fs::path(LOOPWISE_SOURCE_DIR) / "data/gnn/loopwise.json"));
  const auto width = [&](const char* name) { return shipped.at(name).at("shape").back().get<std::size_t>(); };
  const std::size_t E = width("edge.mean"), F = width("unit.mean");
  Json json;
  json["__meta__"] = {{"kind", "loopwise"}};
  json["edge.mean"] = json["edge.std"] = tensor(0, E);
  json["unit.mean"] = json["unit.std"] = tensor(0, F);
  json["message.0.weight"] = tensor(kM, E);
  json["message.0.bias"] = tensor(0, kM);
  json["message.1.weight"] = tensor(kK, kM);
  json["message.1.bias"] = tensor(0, kK);
  json["message.skip.weight"] = tensor(kK, E);
  json["readout.0.weight"] = tensor(kH, 3 * (kK + 2) + F);
  json["readout.0.bias"] = json["readout.1.bias"] = tensor(0, kH);
  json["readout.1.weight"] = tensor(kH, kH);
  json["readout.2.weight"] = tensor(2, kH);
  json["readout.2.bias"] = tensor(0, 2);
  return json.dump();
}

std::string small_graph_network() {
  Json json;
  json["node_encoder.weight"] = tensor(1, 2);
  json["node_encoder.bias"] = tensor(0, 1);
  for (const char* name : {"conv1", "gcs.0"}) {
    const std::string own = name;
    json[own + ".mu"] = json[own + ".sigma"] = tensor(1, 1);
    json[own + ".g"] = json[own + ".root"] = tensor(1, 1);
    json[own + ".bias"] = tensor(0, 1);
  }
  json["lins.0.weight"] = tensor(1, 1);
  json["lins.0.bias"] = tensor(0, 1);
  for (const char* name : {"batch_norms.1", "batch_norms.2"}) {
    for (const char* part : {".weight", ".bias", ".running_mean", ".running_var"}) {
      json[std::string(name) + part] = tensor(0, 1);
    }
  }
  json["lin.weight"] = tensor(1, 1);
  json["lin.bias"] = json["output.mean"] = json["output.std"] = json["output.log"] = tensor(0, 1);
  json["input.mean"] = json["input.std"] = tensor(0, 2);
  return json.dump();
}

std::string store_file() {
  const fs::path folder = scratch() / "seed_store";
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  {
    OutcomeStore store(folder);
    for (const std::uint64_t key : {1U, 2U}) {
      static_cast<void>(store.get({key, key + 1}, result(true).candidate, [&] { return result(key == 1); }));
    }
  }
  return read_file(folder / "outcomes-00000001.bin");
}

/// A robot that walks round three times.
PoseGraph rounds(std::size_t nodes) {
  PoseGraph graph;
  constexpr double kPerRound = 14.0, kPi = 3.14159265358979323846;
  for (std::size_t k = 0; k < nodes; ++k) {
    Node node;
    node.key = k;
    node.stamp_ns = static_cast<std::int64_t>(k) * 1000000000;
    node.pose = Eigen::Isometry3d::Identity();
    const double angle = 2.0 * kPi * static_cast<double>(k) / kPerRound;
    node.pose.translation() << 4.0 * std::cos(angle), 4.0 * std::sin(angle), 0.0;
    graph.add_node(node);
    if (k == 0) {
      PriorFactor prior;
      prior.key = 0;
      prior.pose = node.pose;
      prior.information = 1e4 * Matrix6d::Identity();
      graph.add_prior(prior);
      continue;
    }
    Edge edge;
    edge.from = k - 1;
    edge.to = k;
    edge.T_from_to = graph.node(k - 1).pose.inverse() * node.pose;
    edge.information = 100.0 * Matrix6d::Identity();
    edge.kind = EdgeKind::kOdometry;
    graph.add_edge(edge);
  }
  return graph;
}

/// As small as possible, because the fuzzer alters its parts.
std::string training_file() {
  training::MissionRecord record;
  record.name = "walk";
  record.group = "walks";
  record.graph = rounds(42);
  record.robots = Robots::from_keys(record.graph.keys());
  training::DataOptions options;
  options.candidates = 8;
  options.max_set = 2;
  options.random_sets = 8;
  options.annealing_runs = 0;
  training::MissionData data = training::make_mission_data(record, options);
  data.graphs.resize(1);
  data.graphs[0].sets.resize(2);
  data.record.graph = rounds(2);
  const fs::path file = scratch() / "seed.cbor";
  training::write_mission_data(file, data, "seed");
  return read_file(file);
}

std::string data_list() {
  const fs::path folder = scratch() / "seed_data";
  fs::create_directories(folder);
  std::vector<training::DataSetEntry> entries;
  for (const char* name : {"a", "b", "c"})
    entries.push_back({name, "walks", std::string("missions/") + name + ".cbor", false});
  training::write_data_set(folder, entries, training::DataOptions());
  return read_file(folder / "dataset.json");
}

std::string unit_file() {
  Json summary = Json::object();
  summary["mission_end_s"] = 9.0;
  summary["robots"] = {{"husky", {{"path_length_m", 12.5}}}};
  std::vector<HistoryRow> history(2);
  history[1].mission_time_s = 9.0;
  history[1].computed = 4;
  history[1].ate_m = 0.5;
  return json_text(study::unit_file_json({{"name", "m1"}}, summary, history));
}

/// A header, and one event of each kind.
std::string trace_lines() {
  std::string text;
  TraceWriter writer(parse_robots("a,b"), ModuleOptions(),
                     [&text](const std::string& line) { text += line + "\n"; });
  KeyFrame frame;
  frame.node.key = make_key('a', 1);
  frame.odometry = {{make_key('a', 0), make_key('a', 1)}};
  frame.priors = {{make_key('a', 1)}};
  frame.cloud = std::make_shared<const PointCloud>();
  Factors factors;
  factors.closures = {{make_key('a', 0), make_key('b', 1)}};
  factors.ranges = {{make_key('a', 0), make_key('b', 1), 3.0, 0.1}};
  factors.gravities = {{make_key('a', 0)}};
  RadioReading reading;
  reading.key = make_key('a', 1);
  LoopCandidate candidate;
  candidate.from = make_key('a', 1);
  candidate.to = make_key('b', 1);
  PointCloud corner;
  for (int i = 0; i < 20; ++i)
    corner.points.emplace_back(0.5F * static_cast<float>(i), i % 2 == 0 ? 0.0F : 3.0F, 1.0F);
  const ScanSignature signature(corner);
  ExternalEstimate estimate;
  estimate.poses[make_key('a', 1)] = Eigen::Isometry3d::Identity();
  estimate.covariances[make_key('a', 1)] = Matrix6d::Identity();
  for (const Event& event : std::initializer_list<Event>{
           frame, factors, event::Scan{{make_key('a', 1), 0, frame.cloud}}, event::Radio{{reading}},
           BeaconDrop{"b", 0, make_key('a', 1), 5}, event::Candidates{{candidate}}, result(true),
           result(false), event::BatchDone{{candidate}}, event::Optimized{},
           event::Optimized{{}, false, "singular"}, estimate,
           ClosureDecision{make_key('a', 1), make_key('b', 1), true}, event::Tick{},
           event::Improve{5, {}, {7}}, event::Choose{5}, event::Settle{}, event::NoMoreScans{}}) {
    writer.add({event, 1.5, 0.25, signature});
  }
  return text;
}

}  // namespace

Seeds replay_seeds() {
  Seeds all;
  const std::string config = config_json(Config());
  all["config"] = {{"all", with_choice(0, config)},
                   {"preset", with_choice(0, R"({"generation": {"preset": "lamp", "rate_m": 0.3}})")},
                   {"set", with_choice(1, "generation.rate_m=0.3")},
                   {"list", with_choice(1, "mission.prior_sigmas=1,2,3,4,5,6")},
                   {"method", with_choice(1, "prioritization.method=gi+obs")},
                   {"robots", with_choice(2, "husky=0-624,spot=625-1249")},
                   {"letters", with_choice(2, "a,b")}};
  all["weights"] = {{"effect", small_effect_network()}, {"graph", small_graph_network()}};
  const std::string lines = outcome_line(result(true)) + "\n" + outcome_line(result(false)) + "\n";
  const std::string run = R"({"code":"1","mission":"m","options":{"a":{"b":2}}})";
  all["outcome_line"] = {{"both", lines}, {"file", run + "\n" + lines}};
  const std::string store = store_file();
  all["outcome_store"] = {{"file", with_choice(0, store)},
                          {"payload", with_choice(1, store.substr(32, 534))},
                          {"cut", with_choice(0, "damaged" + store.substr(0, store.size() - 3))}};
  all["training"] = {{"mission", with_choice(0, training_file())}, {"list", with_choice(1, data_list())}};
  all["trace"] = {{"all", trace_lines()}};
  all["study_unit"] = {{"unit", unit_file()}};
  all["key_pairs"] = {
      {"pairs", "# odometry\n0 1\n1,2\n\n8646911284551352320 8646911284551352321 # of another robot\n"}};
#ifdef LOOPWISE_FUZZ_MPI
  RegistrationResult late = result(false);
  late.reason = RejectionReason::kTimeLimit;
  all["mpi_message"] = {{"task", with_choice(0, pack_task(task()))},
                        {"late", with_choice(1, pack_result(late))},
                        {"verified", with_choice(1, pack_result(result(true)))},
                        {"rejected", with_choice(1, pack_result(result(false)))}};
#endif
  return all;
}

}  // namespace loopwise::fuzz
