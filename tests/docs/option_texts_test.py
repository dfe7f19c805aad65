# SPDX-License-Identifier: BSD-3-Clause
"""cmake/option_texts.awk takes the texts of all options from the comments of the headers."""
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
AWK = sys.argv.pop(1) if len(sys.argv) > 1 else "awk"
ROW = re.compile(r'\{"([\w:]+)", "(\w+)", "((?:[^"\\]|\\.)*)"\},')


def run(folder, headers):
    """(exit status, rows, messages) of the script."""
    out = pathlib.Path(folder) / "texts.inc"
    done = subprocess.run([AWK, "-v", f"out={out}", "-f", ROOT / "cmake/option_texts.awk", *headers], cwd=folder, check=False,
                          capture_output=True, text=True)
    rows = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    return done.returncode, [ROW.fullmatch(row).groups() for row in rows], done.stderr


class OptionTexts(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory(prefix="option texts ")
        self.addCleanup(self.folder.cleanup)

    def texts_of(self, text):
        path = pathlib.Path(self.folder.name) / "some options.hpp"
        path.write_text(text, encoding="utf-8")
        return run(self.folder.name, [path.name])

    def test_every_field_of_the_headers_has_a_sentence(self):
        headers = sorted([*ROOT.glob("include/**/*.hpp"), *ROOT.glob("src/**/*.hpp")])
        code = "\n".join(re.sub(r"//.*", "", header.read_text(encoding="utf-8")) for header in headers)
        fields = re.findall(r'\bfield\(\s*"(\w+)"', code)
        self.assertGreater(len(fields), 250)
        status, rows, errors = run(self.folder.name, headers)
        self.assertEqual((status, errors), (0, ""))
        self.assertEqual(sorted(row[1] for row in rows), sorted(fields))
        self.assertEqual(len({row[:2] for row in rows}), len(rows))
        for owner, field, text in rows:
            with self.subTest(f"{owner}::{field}"):
                self.assertRegex(text, r"^([A-Z]|g2o_pcd ).*[.]$")
                self.assertNotRegex(text, r"\.\.\.|  ")

    def test_forms_of_comments_and_declarations(self):
        status, rows, errors = self.texts_of('''
namespace loopwise {
namespace detail {
struct Before { int x = 0; };
}  // namespace detail
/// A struct.
struct LOOPWISE_EXPORT RateOptions {
  /// Two lines of "text", with a back\\slash:
  /// √2 · rate.
  std::map<int, double> rate = {{1, 2.0}};
  int count = 1;  ///< Beside the field
                  ///< and below.
  Part part;      ///< No field of visit().
  /// In braces.
  std::vector<double> sizes{1.0};

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("rate", self.rate, any_value());
    field(
        "count", self.count, at_least(1));
    field("sizes", self.sizes, any_value());
  }
};
}  // namespace loopwise
namespace loopwise::training {
struct RateOptions {
  /// Another one.
  double rate = 1.0;
  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("rate", self.rate, any_value());
  }
};
}  // namespace loopwise::training
''')
        self.assertEqual((status, errors), (0, ""))
        self.assertEqual(rows, [
            ("loopwise::RateOptions", "rate", 'Two lines of \\"text\\", with a back\\\\slash: √2 · rate.'),
            ("loopwise::RateOptions", "count", "Beside the field and below."),
            ("loopwise::RateOptions", "sizes", "In braces."),
            ("loopwise::training::RateOptions", "rate", "Another one."),
        ])

    def test_a_field_without_text_is_named_and_nothing_is_written(self):
        status, rows, errors = self.texts_of('''namespace loopwise {
struct RateOptions {
  /// Of the first.
  int first = 0;
  int second = 0;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("first", self.first, any_value());
    field("second", self.second, any_value());
  }
};
}  // namespace loopwise
''')
        self.assertEqual((status, rows), (1, []))
        self.assertEqual(errors, "some options.hpp:10: loopwise::RateOptions::second has no text: write a /// comment above the field\n")


if __name__ == "__main__":
    unittest.main()
