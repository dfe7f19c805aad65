# SPDX-License-Identifier: BSD-3-Clause
"""The programs are thin: no file under apps is longer than docs/contributing.md says."""
import pathlib
import re
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]


class AppSizes(unittest.TestCase):
    def test_files_of_programs_are_short(self):
        page = " ".join((ROOT / "docs/contributing.md").read_text(encoding="utf-8").split())
        most = int(re.search(r"under `apps` parses arguments and prints, in at most (\d+) lines", page).group(1))
        sizes = {path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
                 for path in (ROOT / "apps").rglob("*.?pp")}
        self.assertGreater(len(sizes), 20)
        self.assertEqual({name: size for name, size in sizes.items() if size > most}, {})


if __name__ == "__main__":
    unittest.main()
