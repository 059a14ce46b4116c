"""A copy of the packages, extended by what the READMEs add: a proposer, an engine, a fingertip and so on."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from helpers.sources import ROOT

READMES = (
    "services/detector/README.md",
    "services/registrar/README.md",
    "services/sensor_gateway/README.md",
    "services/orchestrator/README.md",
    "simulation/README.md",
)
_BLOCK = re.compile(
    r"```python\n# (?P<path>[\w/]+\.py)(?P<table>, in (?P<name>\w+)[^\n]*)?\n(?P<code>.*?)```", re.DOTALL
)


def extend_house(folder: Path) -> list[str]:
    """Copies the packages to `folder`, adds what the READMEs add, and returns the folders to put on PYTHONPATH.

    A table is the class or the constant that a README names; its new line becomes its last one.
    """
    roots = [
        ".",
        "services/detector",
        "services/registrar",
        "services/sensor_gateway",
        "services/orchestrator",
        "simulation",
    ]
    for root in roots:
        for package in (ROOT / root).glob("pretouch*/__init__.py"):
            shutil.copytree(package.parent, folder / root / package.parent.name)
    for readme in READMES:
        for block in _BLOCK.finditer((ROOT / readme).read_text()):
            path = folder / block["path"]
            if block["table"]:
                path.write_text(_with_line(path.read_text(), block["name"], block["code"]))
            else:
                path.write_text(block["code"])
    return [str(folder / root) for root in roots]


def _with_line(source: str, table: str, line: str) -> str:
    """`source` with one more line at the end of the class or tuple `table`."""
    last = re.search(rf"^(class {table}\(|{table} = \().*?\n(?=\n\n|\))", source, re.DOTALL | re.MULTILINE)
    assert last is not None, table
    return source[: last.end()] + line + source[last.end() :]
