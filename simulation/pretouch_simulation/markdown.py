"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def markdown_table(headings: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table with `lines` of cells under the headings; it ends with a newline."""
    every = (headings, ["---"] * len(headings), *lines)
    return "".join("| " + " | ".join(line) + " |\n" for line in every)
