"""What each service of a running `pretouch up` has used of the machine, with the processes that it started."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import psutil


@dataclass
class Usage:
    """One service.

    Attributes:
        pid: its process.
        peak: bytes that it ever held in memory at once; the sum of its processes' own peaks.
        seconds: CPU-seconds so far.
    """

    pid: int
    peak: int = 0
    seconds: float = 0.0


def read_usage(pid: int) -> dict[str, Usage]:
    """Each service below the `pretouch up` with this process id, by its name."""
    services: dict[str, Usage] = {}
    for child in psutil.Process(pid).children():
        words = child.cmdline()
        if "serve" not in words:
            continue
        usage = services[words[words.index("serve") + 1]] = Usage(child.pid)
        for process in (child, *child.children(recursive=True)):
            usage.peak += _read_peak(process.pid)
            times = process.cpu_times()
            usage.seconds += times.user + times.system
    return services


def _read_peak(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)
