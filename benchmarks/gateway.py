"""The sensor gateway's latency, highest rate, cost and memory, beside a bare pyserial reader and a bare gRPC stream.

`python -m benchmarks.gateway --json OUT [--soak SECONDS] [--quick] [--seed S]`

The gateway is a process of its own, as in the field, and so are the fingers behind their ptys, the listeners and the
peers; all of them read the same steady clock. Takes less than four minutes, and the soak besides.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import sys
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from benchmarks import gateway_cost, gateway_latency, gateway_rate, gateway_soak, gateway_table


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes:
        latency: frames by rate, Hz.
        rounds: into which they are split; medians are taken over them.
        search: Hz, between which the highest rate is sought.
        probe: s of each of its trials.
        hold: s for which the highest rate must hold.
        devices: whose cost is measured, for `cost` s.
        soak: s.
        interval: s between two looks at the memory.
    """

    latency: dict[float, int]
    rounds: int
    search: tuple[float, float]
    probe: float
    hold: float
    devices: tuple[int, ...]
    cost: float
    soak: float
    interval: float


FULL = Effort({30.0: 2000, 200.0: 3000}, 5, (1000.0, 4e6), 0.5, 5.0, (1, 64), 10.0, 600.0, 5.0)
QUICK = Effort({30.0: 20, 200.0: 200}, 2, (500.0, 2000.0), 0.1, 0.2, (2,), 0.5, 1.5, 0.25)


def measure(effort: Effort, seed: int, console: Console) -> dict[str, Any]:
    """All figures, in SI units but where a name says otherwise."""
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("latency")

        def advance(what: str) -> None:
            progress.update(task, description=what)

        return {
            "latency": gateway_latency.measure(effort.latency, effort.rounds, seed, advance),
            "rate": gateway_rate.measure(effort.search, effort.probe, effort.hold, seed, advance),
            "cost": gateway_cost.measure(effort.devices, effort.cost, seed, advance),
            "soak": gateway_soak.measure(effort.soak, effort.interval, seed, advance) if effort.soak else None,
        }


def machine() -> dict[str, Any]:
    """What it was measured on."""
    information = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    models = [line.partition(":")[2].strip() for line in information.splitlines() if line.startswith("model name")]
    return {
        "cpu": models[0] if models else platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("grpcio", "numpy", "protobuf", "pyserial")},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument(
        "--quick", action="store_true", help="a little of everything, in seconds; no figures to rely on"
    )
    parser.add_argument("--soak", type=float, help="seconds of the soak; 0: none; default 600")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    effort = QUICK if options.quick else FULL
    if options.soak is not None:
        effort = replace(effort, soak=options.soak)
    console = Console()
    began, load = time.monotonic(), os.getloadavg()[0]
    figures = measure(effort, options.seed, console)
    document = {
        "command": shlex.join(["python", "-m", "benchmarks.gateway", *sys.argv[1:]]),
        "machine": machine() | {"load_before": load, "load_after": os.getloadavg()[0]},
        "n": {f"{rate:g} Hz": frames for rate, frames in effort.latency.items()},
        "seed": options.seed,
        "seconds": time.monotonic() - began,
        **figures,
    }
    options.json.write_text(json.dumps(document, indent=1) + "\n")
    gateway_table.show(document, console)


if __name__ == "__main__":
    main()
