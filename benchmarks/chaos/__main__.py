"""`python -m benchmarks.chaos --processes|--compose [--minutes 30] [--robots 20] [--every 20] [--seed 0] [--json OUT]`.

Every few seconds one part of the fleet, drawn at random, is killed, stopped or cut off, under robots that run whole
sessions with the SDK over REST and gRPC. At the end every fault is mended, the robots finish, and what the store holds
is compared with what they were answered. Exit code 1 if anything differs.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import time
from collections import Counter
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import make_case

from benchmarks.chaos.comparison import compare
from benchmarks.chaos.ledger import Ledger
from benchmarks.chaos.robot import Robot
from benchmarks.fleet.containers import ContainerFleet
from benchmarks.fleet.parts import Fault, Fleet
from benchmarks.fleet.processes import ProcessFleet
from pretouch.client import GrpcClient, RestClient

_SHORTEST = 2.0  # s that a fault lasts at least; at most the time to the next one
_FINISHING = 600.0  # s that robots get to finish their sessions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("--processes", action="store_true", help="the fleet as processes on loopback")
    kind.add_argument("--compose", action="store_true", help="the fleet of docker-compose.yml")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--every", type=float, default=20.0, help="seconds from fault to fault")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--logs", type=Path, help="keep the logs of processes in this folder")
    parser.add_argument("--json", type=Path, help="write the result to this file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="pretouch-chaos-") as folder:
        fleet: AbstractContextManager[Fleet] = (
            ContainerFleet() if arguments.compose else ProcessFleet(_made(arguments.logs or Path(folder)))
        )
        with fleet as running:
            result = run(running, arguments)
    result = {"command": " ".join(sys.argv[1:]), "seed": arguments.seed} | result
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    for name, value in (result["counts"] | result["figures"]).items():
        print(f"{name:32} {value:10.6g}")
    print(f"{'faults':32} {result['faults by kind']}")
    print(f"{'calls that robots made again':32} {result['calls made again']}")
    for line in result["differences"]:
        print("DIFFERENCE", line)
    sys.exit(bool(result["differences"]))


def run(fleet: Fleet, arguments: argparse.Namespace) -> dict[str, Any]:
    """The whole experiment on a running fleet."""
    ledger = Ledger()
    cases = [make_case(name, maker(), 0, arguments.seed) for name, maker in MAKERS.items()]
    robots = [Robot(number, fleet.rest, fleet.grpc, cases, ledger) for number in range(arguments.robots)]
    began = time.monotonic()
    for robot in robots:
        robot.start()
    faults = _break_in_turn(fleet, ledger, random.Random(arguments.seed), began, arguments)
    for robot in robots:
        robot.stop()
    end = time.monotonic() + _FINISHING
    for robot in robots:
        robot.join(max(0.0, end - time.monotonic()))
    late = [robot.name for robot in robots if robot.is_alive()]
    minutes = (time.monotonic() - began) / 60
    with RestClient(fleet.rest, timeout=120.0) as rest, GrpcClient(fleet.grpc, timeout=120.0) as grpc:
        counts, differences = compare(ledger, rest, grpc)
    differences += [f"{name} did not finish within {_FINISHING:g} s" for name in late]
    seconds = np.array(ledger.seconds or [0.0])
    return {
        "counts": counts,
        "figures": {
            "minutes": minutes,
            "calls": len(ledger.seconds),
            "call p50 s": float(np.percentile(seconds, 50)),
            "call p95 s": float(np.percentile(seconds, 95)),
            "call max s": float(seconds.max()),
            "restarts by supervisors": sum(fleet.restarts().values()),
        },
        "faults by kind": dict(Counter(fault["fault"] for fault in faults)),
        "faults by part": dict(Counter(fault["part"] for fault in faults)),
        "calls made again": dict(ledger.failures),
        "differences": differences,
        "faults": faults,
    }


def _break_in_turn(
    fleet: Fleet, ledger: Ledger, rng: random.Random, began: float, arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    """One fault after the other until the time is over; each is mended before the next."""
    faults = []
    following, end = began + arguments.every, began + 60 * arguments.minutes
    while following < end:
        time.sleep(max(0.0, following - time.monotonic()))
        part = rng.choice(fleet.parts)
        fault = rng.choice(fleet.faults(part))
        lasting = rng.uniform(_SHORTEST, max(_SHORTEST, arguments.every - 2.0))
        at = time.monotonic() - began
        fleet.break_part(part, fault)
        try:
            time.sleep(lasting if fault in (Fault.FREEZE, Fault.DROP, Fault.BLACKHOLE) else _SHORTEST)
        finally:
            fleet.mend_part(part, fault)
        faults.append({"at": round(at, 1), "part": part, "fault": fault.value, "steps": ledger.steps})
        print(f"{at:7.1f} s  {part:16} {fault.value:10} {ledger.steps} steps", file=sys.stderr, flush=True)
        following += arguments.every
    return faults


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


main()
