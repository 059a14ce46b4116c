"""The console on which an evaluation reports."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from rich.console import Console

from pretouch.results import STANDARD_OUTPUT

_FILE_WIDTH = 160


def open_console(out: Path) -> Console:
    """Beside rows that go to `out`: standard error where they go to standard output; wide where it is no terminal."""
    known = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(width=None if known else _FILE_WIDTH, stderr=out == STANDARD_OUTPUT)
