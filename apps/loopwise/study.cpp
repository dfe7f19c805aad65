// SPDX-License-Identifier: BSD-3-Clause
#include "command.hpp"
#include "study_arguments.hpp"

namespace loopwise::cli {

void add_study(Command& app, Action& chosen, Transport* job) {
  Command* command = app.add_subcommand("study", "Measure the system, or a part of it, against ground truth");
  command->require_subcommand();
  add_replay_studies(*command, chosen, job);
  add_registration_study(*command, chosen);
  add_acceptance_study(*command, chosen);
}

}  // namespace loopwise::cli
