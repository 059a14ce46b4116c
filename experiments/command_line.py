"""What experiments that go on after they were stopped have in common on the command line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from collecting import RESULTS

from pretouch.errors import PretouchError


def start(parser: argparse.ArgumentParser, run: Callable[[argparse.Namespace], None]) -> None:
    """Adds the options that all have, and runs; what a user can put right is said in one line."""
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, default=RESULTS)
    try:
        run(parser.parse_args())
    except PretouchError as error:
        sys.exit(f"{error.detail} {error.remedy}")
    except KeyboardInterrupt:
        sys.exit("Interrupted. The same command goes on.")
