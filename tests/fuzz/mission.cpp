// SPDX-License-Identifier: BSD-3-Clause
// Whole missions with one file from the fuzzer. The first byte selects it.
#include "mission_seeds.hpp"

#include <loopwise/io/atomic_file.hpp>

#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(mission, bytes) {
  using namespace loopwise;
  struct Place {
    std::filesystem::path folder;
    std::filesystem::path file;
    std::string contents;  // of ours
  };
  static const std::vector<Place> places = [] {
    std::vector<Place> out;
    fuzz::write_seed_missions(fuzz::scratch() / "missions");
    for (const auto& [folder, file] : fuzz::seed_mission_files()) {
      const auto path = fuzz::scratch() / "missions" / folder;
      out.push_back({path, path / file, std::filesystem::exists(path / file) ? read_file(path / file) : ""});
    }
    return out;
  }();
  const Place& place = places[fuzz::take_choice(bytes, places.size())];
  fuzz::put_file(place.file, bytes);
  const bool frames = place.file.filename() == "frames.csv";
  const auto mission = fuzz::attempt([&] {
    if (!frames) return read_mission(place.folder);
    MissionOptions options;
    options.frames = place.file.string();
    return read_missions({place.folder, place.folder.parent_path() / "session2"}, options);
  });
  fuzz::put_file(place.file, place.contents);
  if (!mission) return;
  fuzz::check_mission(*mission);
  if (bytes.size() % 4 != 0 || mission->graph.nodes().size() > 20) return;
  const auto copy = fuzz::scratch() / "copy";
  std::filesystem::remove_all(copy);
  const auto written = fuzz::attempt([&] {
    MissionWriter(copy).finish(*mission);
    return true;
  });
  if (!written) return;
  const Mission again = read_mission(copy);
  fuzz::expect(again.graph.keys() == mission->graph.keys(), "written and read again: the same nodes");
  fuzz::expect(again.graph.edges().size() == mission->graph.edges().size(),
               "written and read again: as many edges");
  fuzz::expect(again.start_ns == mission->start_ns, "written and read again: the same start");
  fuzz::expect(again.radio.size() == mission->radio.size(), "written and read again: as many readings");
}
