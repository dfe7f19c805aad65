// SPDX-License-Identifier: BSD-3-Clause
#include "cloud_round.hpp"

LOOPWISE_FUZZ_TARGET(cloud_pcd, bytes) {
  loopwise::fuzz::read_and_write_cloud("fuzz.pcd", bytes);
}
