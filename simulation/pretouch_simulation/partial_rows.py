"""Rows of a long computation, written as they come so that it can go on after an interruption."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pretouch.errors import Conflict


class PartialRows:
    """One JSON line for each row after a line with the settings, in a file beside the results.

    Args:
        path: of the file; it is made if it is not there. None keeps the rows in memory alone.
        settings: what the rows depend on.
        option: of the command line, that names where the results go.

    Raises:
        Conflict: the file holds rows made with other settings.
    """

    def __init__(self, path: Path | None, settings: dict[str, Any], option: str = "--out") -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = []
        if path is None:
            return
        header = json.dumps(settings, sort_keys=True)
        lines = [header]
        if path.exists():
            text = path.read_text()
            lines = text[: text.rfind("\n") + 1].splitlines() or [header]
            if lines[0] != header:
                raise Conflict(
                    f"{path} holds rows made with other settings.", f"Delete it, or choose another {option}."
                )
            self.rows = [json.loads(line) for line in lines[1:]]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"{line}\n" for line in lines))  # a line cut short by a crash is dropped

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps(row) + "\n")

    def remove(self) -> None:
        if self.path is not None:
            self.path.unlink(missing_ok=True)
