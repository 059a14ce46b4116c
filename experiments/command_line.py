"""What the experiments have in common on the command line."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from experiments.folders import RESULTS
from pretouch.errors import PretouchError


def command_of(name: str, arguments: Sequence[str] | None = None) -> str:
    """The command that runs the experiment `name`; `arguments` None: those that this process was given."""
    return shlex.join(["python", "-m", f"experiments.{name}", *(sys.argv[1:] if arguments is None else arguments)])


def run_resumable(parser: argparse.ArgumentParser, run: Callable[[argparse.Namespace], None]) -> None:
    """Adds `--workers` and `--out`, and runs an experiment that goes on where it was stopped."""
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=RESULTS)
    try:
        run_or_exit(parser.parse_args(), run)
    except KeyboardInterrupt:
        sys.exit("Interrupted. The same command goes on.")


def run_or_exit(arguments: argparse.Namespace, run: Callable[[argparse.Namespace], None]) -> None:
    """Runs; an error of pretouch's own ends the process with one line instead of a traceback."""
    try:
        run(arguments)
    except PretouchError as error:
        sys.exit(f"{error.detail} {error.remedy}")
