// SPDX-License-Identifier: BSD-3-Clause
// A zip archive: each of its files, and the map that LAMP saves in one.
#include "zip_archive.hpp"

#include "checks.hpp"

LOOPWISE_FUZZ_TARGET(zip_archive, bytes) {
  using namespace loopwise;
  const auto file = fuzz::scratch() / "fuzz.zip";
  fuzz::put_file(file, bytes);
  const auto archive = fuzz::attempt([&] { return ZipArchive(file); });
  if (archive) {
    for (std::size_t i = 0; i < archive->names().size(); ++i) {
      static_cast<void>(fuzz::attempt([&] { return archive->read(i); }));
    }
  }
  const auto mission = fuzz::attempt([&] { return read_mission(file); });
  if (mission) fuzz::check_mission(*mission);
}
