# SPDX-License-Identifier: BSD-3-Clause
"""replay_methods.py MISSION: replays of a recorded mission; a study is a loop over them."""
import sys

import loopwise as lw

mission = lw.read_mission(sys.argv[1])
for method in ("baseline", "expected"):
    for seed in (1, 2):
        config = {"engine": {"seed": seed}, "replay": {"max_registrations": 20}}
        run = lw.replay(mission, method=method, config=config)
        print(method, seed, run.summary["ate_m"], run.closures["verified"].sum(), "closures")
