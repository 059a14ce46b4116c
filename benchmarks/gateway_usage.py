"""The CPU time and memory of a process."""

from __future__ import annotations

from dataclasses import dataclass

import psutil


@dataclass(frozen=True)
class Usage:
    """s of CPU so far; bytes of memory at present: all that is resident, and what is this process's alone."""

    cpu: float
    rss: int
    uss: int


def usage_of(pid: int) -> Usage:
    process = psutil.Process(pid)
    times, memory = process.cpu_times(), process.memory_full_info()
    return Usage(times.user + times.system, memory.rss, memory.uss)
