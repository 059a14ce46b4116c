"""`pretouch up` as a process, and its services."""

from __future__ import annotations

import json
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx

READY_WITHIN = 320  # s: a first start compiles the registrar's kernels
TIMEOUT = 60
READY = re.compile(
    r"^pretouch is ready: REST (https?://127\.0\.0\.1:\d+), gRPC (127\.0\.0\.1:\d+), gateway 127\.0\.0\.1:\d+\n$"
)


class Up:
    """A running `pretouch up`; its log goes to a file."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process, self.log = process, log

    @staticmethod
    @contextmanager
    def running(folder: Path, *command: str, **environment: str) -> Iterator[Up]:
        """Python with this command line; its log is in `folder`."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
        with (folder / "up.log").open("w") as log:
            process = subprocess.Popen(
                [sys.executable, *command],
                cwd=Path(__file__).parents[1],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=kept | environment,
            )
        with process:
            try:
                yield Up(process, folder / "up.log")
            finally:
                if process.poll() is None:
                    process.kill()  # the children follow by themselves

    def first_line(self) -> str:
        """What it says on standard output, once it does."""
        assert self.process.stdout is not None
        readable, _, _ = select.select([self.process.stdout], [], [], READY_WITHIN)
        return self.process.stdout.readline() if readable else ""

    def ready(self) -> tuple[str, str]:
        """REST's URL and gRPC's address, from the ready line."""
        line = self.first_line()
        found = READY.match(line)
        assert found, f"{line!r}: {self.log.read_text()}"
        return found[1], found[2]

    def children(self) -> dict[str, int]:
        """The process id of each service."""
        return children_of(self.process.pid)

    def warnings(self) -> list[dict[str, str]]:
        """The log's lines of its own; what others write there is no JSON of its."""
        lines = [json.loads(line) for line in self.log.read_text().splitlines() if line.startswith("{")]
        return [line for line in lines if line["service"] == "up"]


def children_of(parent: int) -> dict[str, int]:
    """The process id of each service that this process started."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, IndexError, ValueError):
            words = (folder / "cmdline").read_bytes().decode().split("\0")
            if int((folder / "stat").read_text().rpartition(")")[2].split()[1]) == parent and "serve" in words:
                found[words[words.index("serve") + 1]] = int(folder.name)
    return found


def alive(pid: int) -> bool:
    with suppress(OSError):
        stat = Path(f"/proc/{pid}/stat").read_text()
        return "pretouch" in Path(f"/proc/{pid}/cmdline").read_text() and stat.rpartition(")")[2].split()[0] != "Z"
    return False


def eventually(holds: Callable[[], bool]) -> None:
    """Returns once `holds()`: other processes tell nobody."""
    for _ in range(20 * TIMEOUT):
        if holds():
            return
        time.sleep(0.05)
    raise AssertionError("it never came to hold")


def answers(url: str) -> int:
    with suppress(httpx.HTTPError):
        return httpx.get(url, timeout=TIMEOUT).status_code
    return 0
