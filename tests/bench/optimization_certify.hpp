// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// The certificate of global optimality on files.
#pragma once

#include <filesystem>
#include <vector>

namespace loopwise::bench {

/// One row a file: optimised, certified, and SE-Sync's cost Σ κ‖·‖² + τ‖·‖², which is twice ours.
void certify_files(const std::vector<std::filesystem::path>& files);

}  // namespace loopwise::bench
