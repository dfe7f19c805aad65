# SPDX-License-Identifier: BSD-3-Clause
"""The code in docs/recipes.md is copied from the programs that it links, and every program is on the page."""
import pathlib
import re
import unittest

DOCS = pathlib.Path(__file__).resolve().parents[2] / "docs"
LINK = re.compile(r"\]\((examples/[^)#]+\.(?:cpp|py))\)")


class Recipes(unittest.TestCase):
    def setUp(self):
        self.page = (DOCS / "recipes.md").read_text()

    def test_every_block_is_text_of_a_program_linked_before_it(self):
        blocks = 0
        linked = []
        for text, language, code in re.findall(r"(.*?)(?:```(\w+)\n(.*?)```|\Z)", self.page, re.DOTALL):
            linked += LINK.findall(text)
            if language not in ("cpp", "python"):
                continue
            blocks += 1
            self.assertTrue(any(code in (DOCS / path).read_text() for path in linked[-2:]), code)
        self.assertGreaterEqual(blocks, 10)

    def test_every_program_is_on_the_page(self):
        programs = [path.relative_to(DOCS).as_posix() for path in (DOCS / "examples" / "recipes").iterdir()
                    if path.suffix in (".cpp", ".py")]
        self.assertEqual(sorted(programs), sorted(set(LINK.findall(self.page)) & set(programs)))


if __name__ == "__main__":
    unittest.main()
