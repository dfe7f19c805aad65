// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The subcommands of loopwise-train, built from the same parts as those of loopwise.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "common/common_options.hpp"
#include "common/console.hpp"

namespace loopwise::training {

using cli::Action;
using cli::CommonOptions;

/// Applies a section of the file of --config and the assignments of --set, SECTION.FIELD=VALUE.
/// \throws OptionError also for a section that this subcommand does not have
template <class Options>
void load_section(const CommonOptions& common, const std::string& section, Options& options) {
  if (!common.config.empty()) {
    const Json json = read_json_file(common.config);
    loopwise::detail::require_object(json, common.config);
    for (const std::string& key : loopwise::detail::json_keys(json)) {
      if (key != section) throw_unknown_name("section", key, {section});
      apply_json(*loopwise::detail::find_json(json, key), section, options);
    }
  }
  for (const std::string& assignment : common.set) {
    const std::size_t dot = assignment.find('.'), equals = assignment.find('=');
    if (dot == std::string::npos || equals == std::string::npos || equals < dot) {
      throw OptionError("--set " + assignment + ", expected " + section + ".FIELD=VALUE");
    }
    if (assignment.substr(0, dot) != section) {
      throw_unknown_name("section", assignment.substr(0, dot), {section});
    }
    set_option(section, assignment.substr(dot + 1, equals - dot - 1), assignment.substr(equals + 1), options);
  }
  validate(options);
}

void add_data(cli::Command& app, Action& chosen);
void add_fit(cli::Command& app, Action& chosen);
void add_evaluate(cli::Command& app, Action& chosen);

}  // namespace loopwise::training
