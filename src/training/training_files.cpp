// SPDX-License-Identifier: BSD-3-Clause
// Files of training data: one per mission, and the list of all missions.
#include <nlohmann/json.hpp>

#include <loopwise/core/content_hash.hpp>
#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/training/training_data.hpp>

#include "packed.hpp"

namespace loopwise::training {
namespace {

constexpr int kFileVersion = 1;

using Packed = nlohmann::json;

Packed pack_poses(const std::vector<Eigen::Isometry3d>& poses) {
  std::vector<double> values;
  for (const Eigen::Isometry3d& T : poses) {
    const Eigen::Matrix<double, 3, 4> top = T.matrix().topRows<3>();
    values.insert(values.end(), top.data(), top.data() + 12);
  }
  return pack(values);
}

Eigen::Isometry3d pose_at(const std::vector<double>& values, std::size_t k) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.matrix().topRows<3>() = Eigen::Map<const Eigen::Matrix<double, 3, 4>>(values.data() + 12 * k);
  return T;
}

Packed pack_graph(const PoseGraph& graph) {
  std::vector<std::uint64_t> keys, prior_keys;
  std::vector<std::int64_t> stamps;
  for (const Node& node : graph.nodes()) {
    keys.push_back(node.key);
    stamps.push_back(node.stamp_ns);
  }
  std::vector<std::uint32_t> ends;
  std::vector<Eigen::Isometry3d> measured, prior_poses;
  std::vector<double> information, prior_information;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    ends.push_back(static_cast<std::uint32_t>(graph.ends(e).from));
    ends.push_back(static_cast<std::uint32_t>(graph.ends(e).to));
    measured.push_back(graph.edges()[e].T_from_to);
    const Matrix6d& m = graph.edges()[e].information;
    information.insert(information.end(), m.data(), m.data() + 36);
  }
  for (const PriorFactor& prior : graph.priors()) {
    prior_keys.push_back(prior.key);
    prior_poses.push_back(prior.pose);
    prior_information.insert(prior_information.end(), prior.information.data(),
                             prior.information.data() + 36);
  }
  return {{"keys", pack(keys)},
          {"stamps_ns", pack(stamps)},
          {"poses", pack_poses(graph.poses())},
          {"ends", pack(ends)},
          {"measured", pack_poses(measured)},
          {"information", pack(information)},
          {"prior_keys", pack(prior_keys)},
          {"prior_poses", pack_poses(prior_poses)},
          {"prior_information", pack(prior_information)}};
}

PoseGraph unpack_graph(const Field& field) {
  const auto keys = field["keys"].values<std::uint64_t>();
  const auto stamps = field["stamps_ns"].values<std::int64_t>(keys.size());
  const auto poses = field["poses"].values<double>(12 * keys.size());
  PoseGraph graph;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    Node node;
    node.key = keys[i];
    node.stamp_ns = stamps[i];
    node.pose = pose_at(poses, i);
    graph.add_node(node);
  }
  const auto ends = field["ends"].values<std::uint32_t>();
  if (ends.size() % 2 != 0) field["ends"].fail("cut short");
  const std::size_t edges = ends.size() / 2;
  const auto measured = field["measured"].values<double>(12 * edges);
  const auto information = field["information"].values<double>(36 * edges);
  for (std::size_t e = 0; e < edges; ++e) {
    if (std::max(ends[2 * e], ends[2 * e + 1]) >= keys.size()) field["ends"].fail("no such node");
    Edge edge;
    edge.from = keys[ends[2 * e]];
    edge.to = keys[ends[2 * e + 1]];
    edge.T_from_to = pose_at(measured, e);
    edge.information = Eigen::Map<const Matrix6d>(information.data() + 36 * e);
    edge.kind = EdgeKind::kOdometry;
    graph.add_edge(edge);
  }
  const auto prior_keys = field["prior_keys"].values<std::uint64_t>();
  const auto prior_poses = field["prior_poses"].values<double>(12 * prior_keys.size());
  const auto prior_information = field["prior_information"].values<double>(36 * prior_keys.size());
  for (std::size_t k = 0; k < prior_keys.size(); ++k) {
    PriorFactor prior;
    prior.key = prior_keys[k];
    prior.pose = pose_at(prior_poses, k);
    prior.information = Eigen::Map<const Matrix6d>(prior_information.data() + 36 * k);
    graph.add_prior(prior);
  }
  return graph;
}

std::vector<std::uint32_t> flat(const std::vector<std::pair<std::uint32_t, std::uint32_t>>& pairs) {
  std::vector<std::uint32_t> out;
  for (const auto& [a, b] : pairs) {
    out.push_back(a);
    out.push_back(b);
  }
  return out;
}

std::vector<std::pair<std::uint32_t, std::uint32_t>> unpack_pairs(const Field& field, std::size_t nodes) {
  const auto values = field.values<std::uint32_t>();
  if (values.size() % 2 != 0) field.fail("cut short");
  std::vector<std::pair<std::uint32_t, std::uint32_t>> out;
  for (std::size_t k = 0; k + 1 < values.size(); k += 2) {
    if (std::max(values[k], values[k + 1]) >= nodes) field.fail("no such node");
    out.emplace_back(values[k], values[k + 1]);
  }
  return out;
}

Packed pack_training_graph(const TrainingGraph& graph) {
  std::vector<std::uint32_t> members, sizes, anchor_nodes, anchor_chains;
  std::vector<double> traces, anchor_values;
  std::vector<float> log_reductions;
  for (const TrainingSet& set : graph.sets) {
    sizes.push_back(static_cast<std::uint32_t>(set.members.size()));
    members.insert(members.end(), set.members.begin(), set.members.end());
    traces.push_back(set.trace_m2);
    log_reductions.insert(log_reductions.end(), set.log_reduction.data(),
                          set.log_reduction.data() + set.log_reduction.size());
  }
  const ClosureEffects& e = graph.effects;
  for (const ClosureEffects::Anchor& anchor : e.anchors) {
    anchor_nodes.push_back(static_cast<std::uint32_t>(anchor.node));
    anchor_chains.push_back(anchor.chain);
    anchor_values.insert(anchor_values.end(), anchor.axes.data(), anchor.axes.data() + 9);
    anchor_values.insert(anchor_values.end(), anchor.variance.data(), anchor.variance.data() + 3);
  }
  const std::vector<std::uint8_t> connecting(e.connecting.begin(), e.connecting.end());
  return {{"stage", graph.stage},
          {"nodes", pack(graph.input.nodes)},
          {"edges", pack(flat(graph.input.edges))},
          {"edge_attributes", pack(graph.input.edge_attributes)},
          {"ends", pack(flat(graph.ends))},
          {"trace_m2", e.trace_m2},
          {"anchor_nodes", pack(anchor_nodes)},
          {"anchor_chains", pack(anchor_chains)},
          {"anchors", pack(anchor_values)},
          {"share", pack(e.share)},
          {"units", pack(e.units)},
          {"relief", pack(e.log_reduction)},
          {"side", pack(e.side)},
          {"gap", pack(e.gap)},
          {"far", pack(e.far)},
          {"reference", pack(e.reference)},
          {"gain", pack(e.gain)},
          {"connecting", pack(connecting)},
          {"set_sizes", pack(sizes)},
          {"set_members", pack(members)},
          {"set_traces_m2", pack(traces)},
          {"set_reliefs", pack(log_reductions)}};
}

TrainingGraph unpack_training_graph(const Field& field) {
  TrainingGraph out;
  out.stage = static_cast<std::size_t>(field["stage"].integer());
  if (out.stage >= stages().size()) field["stage"].fail("no such stage");
  const auto edges = field["edges"].values<std::uint32_t>();
  const auto node_values = field["nodes"].values<double>();
  const auto nodes = static_cast<Eigen::Index>(node_values.size() / 7);
  out.input.nodes = field["nodes"].matrix<double>(nodes, 7);
  out.input.edges = unpack_pairs(field["edges"], static_cast<std::size_t>(nodes));
  out.input.edge_attributes =
      field["edge_attributes"].matrix<double>(static_cast<Eigen::Index>(edges.size() / 2), 4);
  out.ends = unpack_pairs(field["ends"], static_cast<std::size_t>(nodes));
  ClosureEffects& e = out.effects;
  e.trace_m2 = field["trace_m2"].number();
  const auto anchor_nodes = field["anchor_nodes"].values<std::uint32_t>();
  const auto chains = field["anchor_chains"].values<std::uint32_t>(anchor_nodes.size());
  const auto anchors = field["anchors"].values<double>(12 * anchor_nodes.size());
  for (std::size_t a = 0; a < anchor_nodes.size(); ++a) {
    ClosureEffects::Anchor anchor;
    anchor.node = anchor_nodes[a];
    if (static_cast<Eigen::Index>(anchor.node) >= nodes) field["anchor_nodes"].fail("no such node");
    anchor.chain = chains[a];
    anchor.axes = Eigen::Map<const Eigen::Matrix3d>(anchors.data() + 12 * a);
    anchor.variance = Eigen::Map<const Eigen::Vector3d>(anchors.data() + 12 * a + 9);
    e.anchors.push_back(anchor);
  }
  const auto A = static_cast<Eigen::Index>(anchor_nodes.size());
  const auto L = static_cast<Eigen::Index>(out.ends.size());
  e.share = field["share"].matrix<double>(3 * A, 1);
  e.units = field["units"].matrix<double>(3 * A, ClosureEffects::kUnitFeatures);
  e.log_reduction = field["relief"].matrix<float>(3 * A, L);
  e.side = field["side"].matrix<std::uint8_t>(A, L);
  if (e.side.size() > 0 && e.side.maxCoeff() > ClosureEffects::kElsewhere) field["side"].fail("no such side");
  e.gap = field["gap"].matrix<float>(A, L);
  e.far = field["far"].matrix<float>(A, L);
  e.reference = field["reference"].matrix<float>(A, L);
  e.gain = field["gain"].matrix<double>(L, 1);
  for (const std::uint8_t value : field["connecting"].values<std::uint8_t>(out.ends.size())) {
    e.connecting.push_back(value != 0);
  }
  const auto sizes = field["set_sizes"].values<std::uint32_t>();
  const auto members =
      field["set_members"].values<std::uint32_t>(std::accumulate(sizes.begin(), sizes.end(), std::size_t{0}));
  const auto traces = field["set_traces_m2"].values<double>(sizes.size());
  const Eigen::MatrixXf log_reductions =
      field["set_reliefs"].matrix<float>(3 * A, static_cast<Eigen::Index>(sizes.size()));
  std::size_t at = 0;
  for (std::size_t s = 0; s < sizes.size(); ++s) {
    TrainingSet set;
    set.members.assign(members.begin() + static_cast<std::ptrdiff_t>(at),
                       members.begin() + static_cast<std::ptrdiff_t>(at + sizes[s]));
    at += sizes[s];
    for (const std::uint32_t member : set.members) {
      if (static_cast<Eigen::Index>(member) >= L) field["set_members"].fail("no such candidate");
    }
    set.trace_m2 = traces[s];
    if (!(set.trace_m2 > 0.0)) field["set_traces_m2"].fail("a trace is not positive");
    set.log_reduction = log_reductions.col(static_cast<Eigen::Index>(s));
    out.sets.push_back(std::move(set));
  }
  return out;
}

Packed pack_mission(const MissionData& data, const std::string& made_with) {
  Packed robots = Packed::array();
  for (const Robot& robot : data.record.robots.all()) {
    robots.push_back({{"name", robot.name}, {"first", robot.first}, {"last", robot.last}});
  }
  Packed graphs = Packed::array();
  for (const TrainingGraph& graph : data.graphs) graphs.push_back(pack_training_graph(graph));
  return {{"format", "loopwise-training-mission"},
          {"version", kFileVersion},
          {"made_with", made_with},
          {"name", data.record.name},
          {"group", data.record.group},
          {"other_size", data.record.other_size},
          {"robots", robots},
          {"graph", pack_graph(data.record.graph)},
          {"graphs", graphs}};
}

}  // namespace

ContentHash hash_of(const MissionData& data) {
  const std::vector<std::uint8_t> bytes = Packed::to_cbor(pack_mission(data, ""));
  return ContentHasher().bytes(bytes.data(), bytes.size()).finish();
}

void write_mission_data(const std::filesystem::path& path, const MissionData& data,
                        const std::string& made_with) {
  write_packed(path, pack_mission(data, made_with));
}

bool has_mission_data(const std::filesystem::path& path, const std::string& made_with) {
  if (!std::filesystem::exists(path)) return false;
  try {
    const Packed all = read_packed(path, "loopwise-training-mission", kFileVersion);
    return Field(path.string(), all)["made_with"].text() == made_with;
  } catch (const InputError&) {
    return false;
  }
}

MissionData read_mission_data(const std::filesystem::path& path) {
  const Packed all = read_packed(path, "loopwise-training-mission", kFileVersion);
  const Field field(path.string(), all);
  MissionData out;
  out.record.name = field["name"].text();
  out.record.group = field["group"].text();
  out.record.other_size = field["other_size"].flag();
  std::vector<Robot> robots;
  for (const Field& robot : field["robots"].items()) {
    robots.push_back({robot["name"].text(), robot["first"].integer(), robot["last"].integer()});
  }
  try {
    out.record.robots = Robots(std::move(robots));
    out.record.graph = unpack_graph(field["graph"]);
  } catch (const InputError& error) {
    const std::string why = error.what();
    throw InputError(why.rfind(path.string(), 0) == 0 ? why : path.string() + ": " + why);
  }
  if (out.record.graph.empty()) field["graph"].fail("no nodes");
  for (const Node& node : out.record.graph.nodes()) {
    if (!out.record.robots.find(node.key))
      field["robots"].fail("node " + std::to_string(node.key) + " has no robot");
  }
  for (const Field& graph : field["graphs"].items()) out.graphs.push_back(unpack_training_graph(graph));
  if (out.graphs.empty()) field["graphs"].fail("no graphs");
  return out;
}

void write_data_set(const std::filesystem::path& folder, const std::vector<DataSetEntry>& entries,
                    const DataOptions& options) {
  Json missions = Json::array();
  for (const DataSetEntry& entry : entries) {
    missions.push_back({{"name", entry.name},
                        {"group", entry.group},
                        {"other_size", entry.other_size},
                        {"file", entry.file}});
  }
  const Json all = {{"format", "loopwise-training-data"},
                    {"version", kFileVersion},
                    {"options", to_json(options)},
                    {"missions", missions}};
  write_file(folder / "dataset.json", all.dump(1) + "\n");
}

DataSet read_data_set(const std::filesystem::path& folder) {
  const std::filesystem::path path = folder / "dataset.json";
  if (!std::filesystem::exists(path)) {
    throw InputError(folder.string() +
                     ": no dataset.json; make the data with 'loopwise-train data', or continue it if it "
                     "was interrupted");
  }
  const Json json = read_json_file(path);
  DataSet out;
  out.folder = folder;
  const auto bad = [&](const std::string& why) { throw InputError(path.string() + ": " + why); };
  try {
    if (json.at("format") != "loopwise-training-data") bad("not a data set");
    if (json.at("version") != kFileVersion) bad("of another version: make the data again");
    apply_json(json.at("options"), "options", out.options);
    for (const Json& mission : json.at("missions")) {
      out.entries.push_back({mission.at("name").get<std::string>(), mission.at("group").get<std::string>(),
                             mission.at("file").get<std::string>(), mission.at("other_size").get<bool>()});
      const std::string& name = out.entries.back().file;
      const std::filesystem::path file = std::filesystem::path(name).lexically_normal();
      if (name.find('\0') != std::string::npos || file.empty() || file.is_absolute() || *file.begin() == "..")
        bad(Json(name).dump() + " is outside of the data's folder");
      out.entries.back().file = file.string();  // the checked path, without resolving links
    }
  } catch (const nlohmann::json::exception& error) {
    bad(error.what());
  } catch (const OptionError& error) {
    bad(error.what());
  }
  if (out.entries.empty()) bad("no missions");
  return out;
}

MissionData DataSet::read(std::size_t entry) const {
  return read_mission_data(folder / entries[entry].file);
}

}  // namespace loopwise::training
