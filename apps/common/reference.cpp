// SPDX-License-Identifier: BSD-3-Clause
#include "reference.hpp"

#include <memory>
#include <string>
#include <system_error>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>

#include "reference_writers.hpp"

namespace loopwise::cli {

void write_reference(const Command& app, const ValueWords& words, const std::filesystem::path& folder) {
  const CommandPage root = program_page(app, words);
  const std::string name = root.path[0];
  const std::filesystem::path manuals = folder / "man" / "man1",
                              bash = folder / "bash-completion" / "completions",
                              zsh = folder / "zsh" / "site-functions",
                              fish = folder / "fish" / "vendor_completions.d";
  for (const std::filesystem::path& place : {manuals, bash, zsh, fish}) {
    std::error_code failure;
    std::filesystem::create_directories(place, failure);
    if (failure) throw IoError(place.string(), failure.message());
  }
  write_manuals(root, manuals);
  write_file(bash / name, bash_completion(root));
  write_file(zsh / ("_" + name), zsh_completion(root));
  write_file(fish / (name + ".fish"), fish_completion(root));
}

void add_reference(Command& app, Action& chosen, const ValueWords& words) {
  const auto folder = std::make_shared<std::string>();
  Command* command = app.add_subcommand("reference", "Write manual pages and completion for shells");
  command->hide();  // for the build, not for users
  command->add_option("folder", *folder, "Tree as of /usr/share")->type_name("DIR")->required();
  command->callback([folder, words, &app, &chosen] {
    chosen = [folder, words, &app] {
      write_reference(app, words, *folder);
      return kDone;
    };
  });
}

}  // namespace loopwise::cli
