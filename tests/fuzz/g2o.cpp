// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/io/g2o.hpp>

#include "checks.hpp"
#include "g2o_text.hpp"

namespace {

using namespace loopwise;

void check_same(const PoseGraph& a, const PoseGraph& b) {
  fuzz::expect(a.planar() == b.planar(), "written and read again: a planar graph is planar");
  fuzz::expect(a.keys() == b.keys(), "written and read again: the nodes are the same");
  fuzz::expect(a.edges().size() == b.edges().size() && a.priors().size() == b.priors().size(),
               "written and read again: edges and priors are as many");
  for (std::size_t i = 0; i < a.nodes().size(); ++i) {
    fuzz::expect(a.nodes()[i].pose.translation() == b.nodes()[i].pose.translation(),
                 "written and read again: places are the same");
    fuzz::expect((a.nodes()[i].pose.linear() - b.nodes()[i].pose.linear()).cwiseAbs().maxCoeff() < 1e-12,
                 "written and read again: rotations are the same to rounding");
  }
  for (std::size_t i = 0; i < a.edges().size(); ++i) {
    fuzz::expect(a.edges()[i].from == b.edges()[i].from && a.edges()[i].to == b.edges()[i].to &&
                     a.edges()[i].kind == b.edges()[i].kind,
                 "written and read again: edges have their ends");
    fuzz::expect(a.edges()[i].information == b.edges()[i].information,
                 "written and read again: information is the same");
  }
}

}  // namespace

LOOPWISE_FUZZ_TARGET(g2o, bytes) {
  const auto unfinished = fuzz::attempt([&] { return parse_unfinished_g2o(bytes, "fuzz.g2o"); });
  if (unfinished) fuzz::check_graph(unfinished->graph);
  const auto file = fuzz::attempt([&] { return parse_g2o(bytes, "fuzz.g2o"); });
  if (!file) return;
  fuzz::check_graph(file->graph);
  fuzz::check_problems(file->problems);
  fuzz::expect(!file->graph.empty(), "a graph has a vertex");
  check_same(file->graph, parse_g2o(g2o_text(file->graph, file->graph.priors()), "again.g2o").graph);
}
