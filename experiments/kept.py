"""Rows of an experiment kept as they come, so that it goes on after an interruption."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pretouch.errors import Conflict


class Kept:
    """One JSON line for each row, beside the results.

    Args:
        path: of the file; it is made if it is not there.
        settings: what the rows depend on.

    Raises:
        Conflict: the file was left by an experiment with other settings.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self._path = path
        self.rows: list[dict[str, Any]] = []
        header = json.dumps(settings, sort_keys=True)
        lines = [header]
        if path.exists():
            text = path.read_text()
            lines = text[: text.rfind("\n") + 1].splitlines() or [header]
            if lines[0] != header:
                raise Conflict(f"{path} holds rows made with other settings.", "Delete it, or choose another --out.")
            self.rows = [json.loads(line) for line in lines[1:]]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"{line}\n" for line in lines))  # a line cut short by a crash is dropped

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        with self._path.open("a") as file:
            file.write(json.dumps(row) + "\n")

    def remove(self) -> None:
        self._path.unlink(missing_ok=True)
