# SPDX-License-Identifier: BSD-3-Clause
"""hardening_test.py READELF PROGRAM LIBRARY: checks in the files that the protections of LOOPWISE_HARDENING are present."""
import subprocess
import sys

readelf, program, library = sys.argv[1:]


def of(file, what):
    return subprocess.run([readelf, what, "--wide", file], check=True, capture_output=True, text=True).stdout


header, segments, dynamic, symbols = (of(program, w) for w in ("--file-header", "--segments", "--dynamic", "--symbols"))
stack = next(line for line in segments.splitlines() if "GNU_STACK" in line)
in_library = of(library, "--symbols")
holds = {
    "loaded at a place that differs from run to run (PIE)": "DYN" in next(
        line for line in header.splitlines() if line.strip().startswith("Type:")),
    "tables of the linker are read-only": "GNU_RELRO" in segments and ("BIND_NOW" in dynamic or "NOW" in dynamic),
    "the stack is not executable": " RWE " not in stack,
    "the stack is guarded where files are read": "__stack_chk_fail" in in_library,
    "copies of known size are checked": "_chk@" in symbols or "_chk" in in_library.replace("__stack_chk_fail", ""),
}
for what, true in holds.items():
    print("yes" if true else "NO ", what)
sys.exit(0 if all(holds.values()) else 1)
