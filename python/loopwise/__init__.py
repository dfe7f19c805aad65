# SPDX-License-Identifier: BSD-3-Clause
"""Loop closure prioritisation for multi-robot lidar SLAM.

    import loopwise as lw

    mission = lw.read_mission("data/sample_mission")
    run = lw.replay(mission, method="full")
    print(run.summary["ate_m"], run.closures["verified"].sum())

Keys are 64-bit integers (or "a12" where a function takes one). Poses are (4, 4) arrays, T_world_body; tangent vectors,
sigmas, covariances and information have the order translation, rotation, in m and rad.
"""

from ._loopwise import *  # noqa: F401,F403
from ._loopwise import __version__  # noqa: F401
