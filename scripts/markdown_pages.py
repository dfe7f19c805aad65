# SPDX-License-Identifier: BSD-3-Clause
"""The Markdown pages of the repository: their paths, their headings with anchors, and their links."""
import pathlib
import re

ROOT = pathlib.Path(__file__).resolve().parent.parent


def pages(root):
    """All pages, in the order of their paths."""
    found = [*root.glob("*.md"), *root.glob("docs/**/*.md"), *root.glob(".github/**/*.md"), *root.glob("web/*.md"),
             *root.glob("data/**/*.md")]
    return sorted(found)


def lines_of_prose(text):
    """(line number, line) outside of fenced code."""
    fenced = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif not fenced:
            yield number, line


def slug(heading, taken):
    """The anchor that GitHub gives a heading; `taken` counts the anchors of the page so far."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    text = re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
    count = taken.get(text, 0)
    taken[text] = count + 1
    return f"{text}-{count}" if count else text


def headings(text):
    """(line number, level, heading, anchor) of a page."""
    taken = {}
    for number, line in lines_of_prose(text):
        match = re.match(r"(#{1,6})\s+(.*?)\s*#*$", line)
        if match:
            yield number, len(match[1]), match[2], slug(match[2], taken)


def links(text):
    """(line number, target) of all links and images of a page, of other sites too."""
    for number, line in lines_of_prose(text):
        line = re.sub(r"`[^`]*`", "`", line)
        for match in re.finditer(r"\]\(\s*<?([^)\s>]+)>?(?:\s+\"[^\"]*\")?\s*\)", line):
            yield number, match[1]


def is_external(target):
    """Whether a link leads to another site."""
    return re.match(r"[a-z][a-z0-9+.-]*:", target, re.IGNORECASE) is not None
