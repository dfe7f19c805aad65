// SPDX-License-Identifier: BSD-3-Clause
// The training's data. The first byte chooses: the file of a mission, or the list of all.
#include <loopwise/training/training_data.hpp>

#include "checks.hpp"

namespace loopwise {
namespace {

void read_mission_file(std::string_view bytes) {
  const auto file = fuzz::scratch() / "training.cbor", again = fuzz::scratch() / "again.cbor";
  fuzz::put_file(file, bytes);
  const auto data = fuzz::attempt([&] { return training::read_mission_data(file); });
  static_cast<void>(fuzz::attempt([&] { return training::has_mission_data(file, "seed"); }));
  if (!data) return;
  fuzz::check_graph(data->record.graph);
  for (const training::TrainingGraph& graph : data->graphs) {
    const ClosureEffects& effects = graph.effects;
    const auto candidates = static_cast<Eigen::Index>(graph.ends.size());
    fuzz::expect(graph.stage < training::stages().size(), "a stage is one that there is");
    fuzz::expect(effects.candidates() == candidates && effects.gain.size() == candidates &&
                     effects.connecting.size() == graph.ends.size(),
                 "effects are of the candidates");
    fuzz::expect(effects.unit_count() == 3 * static_cast<Eigen::Index>(effects.anchors.size()),
                 "three units for each anchor");
    for (Eigen::Index c = 0; c < candidates; ++c) {
      fuzz::expect(effects.edge_features(c).rows() == effects.unit_count(), "features of every unit");
    }
    for (const training::TrainingSet& set : graph.sets) {
      fuzz::expect(set.log_reduction.size() == effects.unit_count(), "a target for each unit");
      for (const std::uint32_t member : set.members)
        fuzz::expect(member < graph.ends.size(), "members are candidates");
    }
  }
  training::write_mission_data(again, *data);
  const training::MissionData copy = training::read_mission_data(again);
  fuzz::expect(
      copy.record.graph.keys() == data->record.graph.keys() && copy.graphs.size() == data->graphs.size(),
      "written and read again: the same");
}

void read_list(std::string_view bytes) {
  const auto folder = fuzz::scratch() / "data";
  std::filesystem::create_directories(folder);
  fuzz::put_file(folder / "dataset.json", bytes);
  const auto set = fuzz::attempt([&] { return training::read_data_set(folder); });
  if (!set) return;
  for (const training::DataSetEntry& entry : set->entries) {
    const auto inside =
        (folder / entry.file).lexically_normal().lexically_relative(folder.lexically_normal());
    fuzz::expect(!inside.empty() && *inside.begin() != "..", "files lie in the folder");
  }
  const auto roles = fuzz::attempt([&] { return training::split_by_mission(set->entries, 1); });
  fuzz::expect(!roles || roles->size() == set->entries.size(), "every mission has a role");
}

}  // namespace
}  // namespace loopwise

LOOPWISE_FUZZ_TARGET(training, bytes) {
  using namespace loopwise;
  fuzz::take_choice(bytes, 2) == 0 ? read_mission_file(bytes) : read_list(bytes);
}
