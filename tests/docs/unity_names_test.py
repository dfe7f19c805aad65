# SPDX-License-Identifier: BSD-3-Clause
"""Sources of a component or program compile together (LOOPWISE_UNITY_BUILD), so a function in an unnamed namespace would hide a function of
the component with its name, and change the calls of other sources without an error."""
import pathlib
import re
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
FUNCTION = re.compile(r"(?! )(?:\[\[nodiscard\]\] |LOOPWISE_EXPORT |inline |constexpr |static )*[\w:<>,&* ]+[ &*](\w+)\(")


def unnamed(text):
    return "".join(re.findall(r"(?ms)^namespace \{\n(.*?)^\}  // namespace\n", text))


def free_functions(text):
    """Names of functions that begin a line: neither members nor calls."""
    names = set()
    for line in text.splitlines():
        found = FUNCTION.match(line)
        if found and not re.match(r"(using|struct|class|enum|return|friend|template|const \w+ \w+ =|constexpr [^(]*=)", line):
            names.add(found.group(1))
    return names


def hidden(folder):
    declared = {}
    for header in [*(ROOT / folder).glob("*.hpp"), *(ROOT / "include/loopwise" / pathlib.Path(folder).name).glob("*.hpp")]:
        for name in free_functions(header.read_text(encoding="utf-8")):
            declared.setdefault(name, []).append(header.name)
    return [f"{folder}/{source.name}: {name}() is also in {', '.join(declared[name])}"
            for source in sorted((ROOT / folder).glob("*.cpp"))
            for name in sorted(free_functions(unnamed(source.read_text(encoding="utf-8"))) & declared.keys())]


class UnityNames(unittest.TestCase):
    def test_no_unnamed_function_hides_one_of_the_component(self):
        folders = [str(path.relative_to(ROOT)) for parent in ("src", "apps") for path in (ROOT / parent).iterdir() if path.is_dir()]
        self.assertGreater(len(folders), 12)
        self.assertEqual([line for folder in sorted(folders) for line in hidden(folder)], [])

    def test_each_test_source_has_its_namespace(self):
        sources = sorted((ROOT / "tests").glob("*/*_test.cpp"))
        self.assertGreater(len(sources), 100)
        missing = [str(source.relative_to(ROOT)) for source in sources if "loopwise_add_tests" in (source.parent / "CMakeLists.txt").read_text(encoding="utf-8")
                   and not re.search(rf"^namespace loopwise[\w:]*::{source.stem} {{$", source.read_text(encoding="utf-8"), re.M)]
        self.assertEqual(missing, [])

    def test_finds_functions(self):
        text = "namespace {\n\nstd::string inflate(std::string_view data) {\n}\n\n}  // namespace\n"
        self.assertEqual(free_functions(unnamed(text)), {"inflate"})
        self.assertEqual(free_functions("[[nodiscard]] std::string inflate(int most);\n  void member();\n"), {"inflate"})


if __name__ == "__main__":
    unittest.main()
