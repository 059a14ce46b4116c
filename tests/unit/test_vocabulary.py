"""The words that docs/glossary.md retires are in no name of a file, class, function or variable."""

import ast
import re
from collections.abc import Iterator

from helpers.sources import ROOT, sources

RETIRED = (
    "foretell",
    "foretold",
    "foresee",
    "foreseen",
    "foresight",
    "kit",
    "tally",
    "succession",
    "intake",
    "utils",
    "misc",
    "evidence",
    "judged",
    "verdict",
)
NAME = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def words(name: str) -> set[str]:
    """The words of a name in snake_case or CamelCase, in small letters."""
    return {word.lower() for word in NAME.findall(name)}


def names(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def test_words_of_a_name() -> None:
    assert words("ServiceKit_foreseenError2") == {"service", "kit", "foreseen", "error"}


def test_no_name_has_a_retired_word() -> None:
    files = sources()
    assert len(files) > 400
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in files
        for name in [path.stem, *names(ast.parse(path.read_text()))]
        if words(name) & set(RETIRED)
    ]
    assert not found


def test_the_glossary_names_each_retired_word() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    assert [word for word in RETIRED if word[:6] not in text] == []
