# SPDX-License-Identifier: BSD-3-Clause
"""scripts/lint_words, lint_links, lint_names and lint_headers find their kinds of faults and report nothing else."""
import pathlib
import subprocess
import sys
import tempfile
import unittest

SCRIPTS = pathlib.Path(__file__).resolve().parents[2] / "scripts"


class Linter(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.root = pathlib.Path(self.folder.name).resolve()
        self.addCleanup(self.folder.cleanup)

    def write(self, name, text):
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def run_linter(self, name):
        run = subprocess.run([sys.executable, SCRIPTS / name, "--root", self.root], check=False, capture_output=True, text=True)
        return run.returncode, run.stdout


class Words(Linter):
    def findings(self, name, text):
        self.write(name, text)
        status, out = self.run_linter("lint_words")
        self.assertEqual(status, 1 if out else 0, out)
        return out

    def test_words_that_readers_must_decode(self):
        for text in ("The caller is told.", "Scripts mend that.", "Files of whatever kind.", "There is none of it.",
                     "It waits in vain.", "The next run goes on with it.", "What is pending then is never computed.",
                     "The result is spoilt.", "Say what came of them.", "The behavior is defined."):
            with self.subTest(text):
                self.assertIn("page.md:3:", self.findings("docs/page.md", f"# Page\n\n{text}\n"))

    def test_plain_sentences_code_and_names_pass(self):
        text = ("# What it shows\n\nWhat does it cost? The run reports `told` and [it](mended.md).\n\n"
                "```\nmend(whatever)\n```\n\n    what is told\n\nSee `optimize()` and optimize_gnc().\n")
        self.assertEqual(self.findings("docs/page.md", text), "")

    def test_comments_of_headers_and_messages_of_the_command_line(self):
        out = self.findings("include/loopwise/a.hpp", '#pragma once\n/// What is known.\nint told;  ///< told\n')
        self.assertEqual([line.split(":")[1] for line in out.splitlines()], ["2", "3"])
        self.write("include/loopwise/a.hpp", 'const char* text = "told";\n')
        out = self.findings("apps/loopwise/b.cpp", 'int whatever;\nauto text = "the caller is told";\n')
        self.assertEqual([line.split(":")[:2] for line in out.splitlines()], [["apps/loopwise/b.cpp", "2"]])


class Links(Linter):
    def test_links_to_files_folders_headings_and_other_sites(self):
        self.write("docs/other.md", "# Other\n\n## The `truth`: a file\n\n## Twice\n\n## Twice\n")
        self.write("docs/page.md", "# Page\n\n[a](other.md#the-truth-a-file) [b](../docs) [c](#page) [d](https://x.org/y)\n"
                                   "[e](other.md#twice-1) `[f](nowhere.md)`\n\n```\n[g](nowhere.md)\n```\n")
        self.assertEqual(self.run_linter("lint_links"), (0, ""))

    def test_broken_links_name_page_line_and_reason(self):
        self.write("docs/other.md", "# Other\n")
        self.write("docs/page.md", "# Page\n\n[a](nowhere.md)\n[b](other.md#no-such)\n![c](no.png)\n[d](../../away.md)\n")
        status, out = self.run_linter("lint_links")
        self.assertEqual(status, 1)
        self.assertEqual([line.split(":")[1] for line in out.splitlines()], ["3", "4", "5", "6"])
        self.assertIn("docs/page.md:4: other.md#no-such: other.md has no heading with the anchor no-such", out)


class Names(Linter):
    def test_names_that_the_code_lacks(self):
        self.write("src/a.cpp", "int found() { return 1; }  // not_here\nenum class Kind { kOne };\nstruct Thing { int field; };\n")
        self.write("include/loopwise/a.hpp", "/// See found(), Kind::kOne and Thing::field; std::move() is of others.\n"
                                             "/// See not_here() or Thing::absent.\nint found();  ///< kTwo\n")
        self.write("docs/page.md", "# Page\n\n`found()` and `lost()`\n\n```\nlost()\n```\n")
        status, out = self.run_linter("lint_names")
        self.assertEqual(status, 1)
        self.assertEqual([line.rsplit(": ", 1)[1].split()[0] for line in out.splitlines()], ["not_here", "absent", "kTwo", "lost"])


class Headers(Linter):
    def test_headers_that_lack_an_include(self):
        self.write("include/loopwise/core/pose_graph.hpp", "#pragma once\n#include <Eigen/Geometry>\n"
                                                           "struct Graph { Eigen::Isometry3d pose; };\n")
        self.write("include/loopwise/core/whole.hpp", "#pragma once\n#include <loopwise/core/pose_graph.hpp>\nextern Graph graph;\n")
        self.assertEqual(self.run_linter("lint_headers"), (0, "lint_headers: 2 of 2 headers compile alone\n"))
        self.write("include/loopwise/core/no_graph.hpp", "#pragma once\n#include <Eigen/Geometry>\nextern Graph graph;\n")
        self.write("include/loopwise/core/no_eigen.hpp", "#pragma once\n#include <vector>\nextern Eigen::Vector3d point;\n")
        self.write("include/loopwise/core/no_vector.hpp", "#pragma once\nextern std::vector<int> numbers;\n")
        self.assertEqual(self.run_linter("lint_headers"), (1, "lint_headers: 2 of 5 headers compile alone\n"))
        self.write("include/loopwise/core/pose_graph.hpp", "#pragma once\nstruct Graph { Eigen::Isometry3d pose; };\n")
        self.assertEqual(self.run_linter("lint_headers"), (1, "lint_headers: 0 of 5 headers compile alone\n"))


if __name__ == "__main__":
    unittest.main()
