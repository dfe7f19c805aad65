// SPDX-License-Identifier: BSD-3-Clause
#include "bindings.hpp"

#include <loopwise/core/error.hpp>
#include <loopwise/core/robots.hpp>

namespace loopwise::python {
namespace {

/// (6, 6), or six sigmas: x y z in m, then rotation in rad.
Matrix6d information_from(const py::object& information, const py::object& sigmas, const std::string& what) {
  if (information.is_none() == sigmas.is_none()) {
    throw InputError(what + ": give either information or sigmas");
  }
  if (!information.is_none()) {
    const Doubles values = array_from(information, {6, 6}, what + ": information");
    return Eigen::Map<const RowMatrix6d>(values.data());
  }
  const Doubles array = array_from(sigmas, {6}, what + ": sigmas");
  const Vector6d values = Eigen::Map<const Vector6d>(array.data());
  if (!(values.array() > 0.0).all()) throw InputError(what + ": sigmas must be positive");
  return values.cwiseAbs2().cwiseInverse().asDiagonal();
}

py::dict edges_dict(const PoseGraph& graph) {
  std::vector<Key> from, to;
  std::vector<Eigen::Isometry3d> T;
  std::vector<Matrix6d> information;
  py::array_t<double> weight(static_cast<py::ssize_t>(graph.edges().size()));
  py::list kind;
  for (std::size_t e = 0; e < graph.edges().size(); ++e) {
    const Edge& edge = graph.edges()[e];
    from.push_back(edge.from);
    to.push_back(edge.to);
    T.push_back(edge.T_from_to);
    information.push_back(edge.information);
    weight.mutable_at(static_cast<py::ssize_t>(e)) = edge.weight;
    kind.append(py::cast(edge.kind));
  }
  py::dict out;
  out["from"] = keys_array(from);
  out["to"] = keys_array(to);
  out["T_from_to"] = poses_array(T);
  out["information"] = matrices_array(information);
  out["weight"] = weight;
  out["kind"] = kind;
  return out;
}

void bind_keys(py::module_& module) {
  module.def("key", &key_from, py::arg("name"), "The 64-bit key of \"a12\", or of a number.");
  module.def(
      "make_key",
      [](const std::string& character, std::uint64_t index) {
        if (character.size() != 1) throw InputError("a robot's character is one letter");
        return make_key(character[0], index);
      },
      py::arg("character"), py::arg("index"), "Key of a robot's node.");
  module.def("key_name", &key_name, py::arg("key"), "\"a12\" for people; plain numbers stay as they are.");

  py::enum_<EdgeKind>(module, "EdgeKind")
      .value("ODOMETRY", EdgeKind::kOdometry)
      .value("LOOP_CLOSURE", EdgeKind::kLoopClosure)
      .value("LANDMARK", EdgeKind::kLandmark);

  py::class_<Robots>(module, "Robots", "Which key belongs to which robot.")
      .def(py::init(&parse_robots), py::arg("text"), "\"a,b\" or \"husky=0-624,spot=625-1249\"")
      .def("__len__", &Robots::size)
      .def_property_readonly("names",
                             [](const Robots& robots) {
                               std::vector<std::string> names;
                               for (const Robot& robot : robots.all()) names.push_back(robot.name);
                               return names;
                             })
      .def("of", &Robots::of, py::arg("key"), "Number of the robot that owns the key.");
}

void bind_factors(py::class_<PoseGraph>& type) {
  type.def(
          "add_node",
          [](PoseGraph& graph, const py::object& key, const py::object& pose, std::int64_t stamp_ns) {
            Node node;
            node.key = key_from(key);
            node.pose = pose_from(pose, "node " + key_name(node.key));
            node.stamp_ns = stamp_ns;
            return graph.add_node(node);
          },
          py::arg("key"), py::arg("pose"), py::arg("stamp_ns") = 0, "Returns the node's number.")
      .def(
          "add_prior",
          [](PoseGraph& graph, const py::object& key, const py::object& pose, const py::object& information,
             const py::object& sigmas) {
            const Key k = key_from(key);
            const std::string what = "prior of " + key_name(k);
            return graph.add_prior({k, pose_from(pose, what), information_from(information, sigmas, what)});
          },
          py::arg("key"), py::arg("pose"), py::arg("information") = py::none(),
          py::arg("sigmas") = py::none())
      .def(
          "add_edge",
          [](PoseGraph& graph, const py::object& from, const py::object& to, const py::object& T_from_to,
             const py::object& information, const py::object& sigmas, EdgeKind kind) {
            Edge edge;
            edge.from = key_from(from);
            edge.to = key_from(to);
            const std::string what = "edge " + key_name(edge.from) + " to " + key_name(edge.to);
            edge.T_from_to = pose_from(T_from_to, what);
            edge.information = information_from(information, sigmas, what);
            edge.kind = kind;
            return graph.add_edge(edge);
          },
          py::arg("from_key"), py::arg("to_key"), py::arg("T_from_to"), py::arg("information") = py::none(),
          py::arg("sigmas") = py::none(), py::arg("kind") = EdgeKind::kLoopClosure)
      .def(
          "add_range",
          [](PoseGraph& graph, const py::object& from, const py::object& to, double range_m, double sigma_m) {
            return graph.add_range({key_from(from), key_from(to), range_m, sigma_m});
          },
          py::arg("from_key"), py::arg("to_key"), py::arg("range_m"), py::arg("sigma_m"))
      .def(
          "add_gravity",
          [](PoseGraph& graph, const py::object& key, const py::object& direction, double sigma_rad) {
            GravityFactor gravity;
            gravity.key = key_from(key);
            gravity.direction = Eigen::Map<const Eigen::Vector3d>(
                array_from(direction, {3}, "gravity at " + key_name(gravity.key) + ": direction").data());
            gravity.sigma_rad = sigma_rad;
            return graph.add_gravity(gravity);
          },
          py::arg("key"), py::arg("direction"), py::arg("sigma_rad"))
      .def("add_closure", &PoseGraph::add_closure, py::arg("closure"))
      .def(
          "classify_edges",
          [](PoseGraph& graph, const py::object& robots) {
            return problem_lines(classify_edges(graph, robots_from(robots, graph)));
          },
          py::arg("robots") = py::none(),
          "Edges between neighbours of one robot become odometry, all others loop closures. Returns flaws of "
          "the "
          "odometry, such as a broken chain.");
}

void bind_contents(py::class_<PoseGraph>& type) {
  type.def(
          "index_of",
          [](const PoseGraph& graph, const py::object& key) { return graph.index_of(key_from(key)); },
          py::arg("key"), "Number of a node: its row in poses and covariances.")
      .def_property(
          "planar", &PoseGraph::planar, [](PoseGraph& graph, bool planar) { graph.set_planar(planar); },
          "Whether the graph is in the plane z = 0. Values that leave the plane are then an error.")
      .def_property_readonly("keys", [](const PoseGraph& graph) { return keys_array(graph.keys()); })
      .def_property(
          "poses", [](const PoseGraph& graph) { return poses_array(graph.poses()); },
          [](PoseGraph& graph, const Doubles& poses) { graph.set_poses(poses_from(poses)); }, "(n, 4, 4)")
      .def_property_readonly("stamps_ns",
                             [](const PoseGraph& graph) {
                               py::array_t<std::int64_t> out(static_cast<py::ssize_t>(graph.nodes().size()));
                               for (std::size_t i = 0; i < graph.nodes().size(); ++i) {
                                 out.mutable_at(static_cast<py::ssize_t>(i)) = graph.nodes()[i].stamp_ns;
                               }
                               return out;
                             })
      .def_property_readonly(
          "edges", &edges_dict,
          "Arrays over the edges: from, to, T_from_to (m, 4, 4), information (m, 6, 6), weight; "
          "and the list kind.")
      .def_property_readonly("priors", [](const PoseGraph& graph) { return graph.priors().size(); })
      .def(
          "set_weights",
          [](PoseGraph& graph, const std::vector<double>& weights) {
            if (weights.size() != graph.edges().size()) {
              throw InputError(std::to_string(weights.size()) + " weights for " +
                               std::to_string(graph.edges().size()) + " edges");
            }
            for (std::size_t e = 0; e < weights.size(); ++e) graph.set_weight(e, weights[e]);
          },
          py::arg("weights"), "One for each edge, in [0, 1].");
}

void bind_pose_graph(py::module_& module) {
  py::class_<PoseGraph> type(
      module, "PoseGraph",
      "Poses and the measurements between them. Poses are (4, 4), T_world_body; covariances and "
      "information have the order translation, rotation.");
  type.def(py::init<>())
      .def("__len__", [](const PoseGraph& graph) { return graph.nodes().size(); })
      .def("__contains__",
           [](const PoseGraph& graph, const py::object& key) { return graph.contains(key_from(key)); })
      .def("copy", [](const PoseGraph& graph) { return PoseGraph(graph); });
  bind_factors(type);
  bind_contents(type);
}

void bind_candidates(py::module_& module) {
  py::enum_<CandidateSource>(module, "CandidateSource")
      .value("PROXIMITY", CandidateSource::kProximity)
      .value("RADIO", CandidateSource::kRadio)
      .value("USER", CandidateSource::kUser)
      .value("APPEARANCE", CandidateSource::kAppearance);
  py::class_<LoopCandidate>(module, "LoopCandidate", "A hypothesis that two nodes saw the same place.")
      .def(py::init([](const py::object& from, const py::object& to, CandidateId id) {
             LoopCandidate candidate;
             candidate.id = id;
             candidate.from = key_from(from);
             candidate.to = key_from(to);
             candidate.source = CandidateSource::kUser;
             return candidate;
           }),
           py::arg("from_key"), py::arg("to_key"), py::arg("id") = 0)
      .def_readwrite("id", &LoopCandidate::id)
      .def_readwrite("from_key", &LoopCandidate::from)
      .def_readwrite("to_key", &LoopCandidate::to)
      .def_readwrite("source", &LoopCandidate::source)
      .def_readwrite("time_s", &LoopCandidate::time_s)
      .def_readwrite("distance_m", &LoopCandidate::distance_m)
      .def("__repr__", [](const LoopCandidate& c) {
        return "<LoopCandidate " + std::to_string(c.id) + ": " + key_name(c.from) + " to " + key_name(c.to) +
               ">";
      });
}

void bind_results(py::module_& module) {
  py::class_<LoopClosure>(module, "LoopClosure", "A computed candidate that passed all tests.")
      .def_readonly("from_key", &LoopClosure::from)
      .def_readonly("to_key", &LoopClosure::to)
      .def_property_readonly("T_from_to", [](const LoopClosure& c) { return matrix_from(c.T_from_to); })
      .def_property_readonly(
          "covariance", [](const LoopClosure& c) { return RowMatrix6d(c.covariance); },
          "(6, 6), order translation, rotation");

  py::class_<RegistrationResult>(module, "RegistrationResult", "What came of one candidate.")
      .def_readonly("candidate", &RegistrationResult::candidate)
      .def_property_readonly("verified", &RegistrationResult::verified)
      .def_property_readonly(
          "reason", [](const RegistrationResult& r) { return enum_name(r.reason); },
          "empty if verified, else why it was rejected")
      .def_readonly("message", &RegistrationResult::message)
      .def_readonly("closure", &RegistrationResult::closure, "None unless verified")
      .def_property_readonly("T_from_to",
                             [](const RegistrationResult& r) -> py::object {
                               if (!r.T_from_to) return py::none();
                               return py::cast(matrix_from(*r.T_from_to));
                             })
      .def_readonly("fitness_m2", &RegistrationResult::gicp_fitness_m2)
      .def_readonly("overlap", &RegistrationResult::overlap)
      .def_property_readonly("seconds", &RegistrationResult::seconds);
}

}  // namespace

void bind_core(py::module_& module) {
  bind_keys(module);
  bind_pose_graph(module);
  bind_candidates(module);
  bind_results(module);
}

}  // namespace loopwise::python
