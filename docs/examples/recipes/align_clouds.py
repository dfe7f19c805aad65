# SPDX-License-Identifier: BSD-3-Clause
"""align_clouds.py TARGET SOURCE: the pose of one scan in the frame of another."""
import sys

import numpy as np

import loopwise as lw

target, source = (lw.read_cloud(path)["points"] for path in sys.argv[1:3])
result = lw.align(target, source)
if not result.success:
    sys.exit(f"not aligned: {result.reason}, {result.message}")
print("T_target_source:", result.T_target_source, sep="\n")
print("sigmas:", np.sqrt(np.diag(result.covariance)))
