"""What an open RegisterStream costs the registrar: `python -m benchmarks.stream_memory [--json OUT]`.

One registrar as its own process; STREAMS streams at once, each with a scene of its own, fed scan after scan at the same
time; all are held open until every one has its last answer. Resident memory before, at its peak, and after the last one
has closed; how much of a stream's answer was late is no question here, so that the queue is made long enough for all.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import time
from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import psutil
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import PLACE, TABLE, Case, generator, make_case
from pretouch_simulation.scanning import scan_along

from pretouch.channel import open_channel
from pretouch.geometry import Plane
from pretouch.scene import Scene as View
from pretouch.serving.child import Child, serve_command
from pretouch.tof import Sensor
from pretouch.trajectory import Trajectory
from pretouch.v1.common_pb2 import Scan, Scene
from pretouch.v1.registrar_pb2 import RegisterStreamHeader, RegisterStreamRequest
from pretouch.v1.registrar_pb2_grpc import RegistrarServiceStub
from pretouch.wire.common import scan_to_proto, scene_to_proto

STREAMS = 100
SCANS = 3
SEED = 0
_MARGIN = 0.1
_CHUNK = 2**20
_TIMEOUT = 600.0
_POLL = 0.02


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--streams", type=int, default=STREAMS)
    arguments = parser.parse_args()
    figures = asyncio.run(measure(arguments.streams))
    for name, value in figures.items():
        print(f"{name:34} {value:10.2f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


async def measure(streams: int = STREAMS) -> dict[str, float]:
    """Megabytes of the registrar's process, and what it was given."""
    cases = [make_case(name, maker(), 0, SEED) for name, maker in MAKERS.items()]
    targets = [scene_to_proto(_scene(cases[k % len(cases)], k)) for k in range(streams)]
    scans = [_scans(case) for case in cases]
    environment = os.environ | {"PRETOUCH_MAX_QUEUE": str(2 * streams)}
    registrar = Child("registrar", serve_command("registrar"), 0, environment, lambda line, fields: None)
    ready = asyncio.create_task(registrar.wait_until_ready())
    try:
        async with open_channel(f"127.0.0.1:{await ready}") as channel:
            stub = RegistrarServiceStub(channel)
            (process,) = (each for each in psutil.Process().children() if "registrar" in each.cmdline())
            await _stream(stub, scene_to_proto(_scene(cases[0], -1)), scans[0], asyncio.Barrier(1))
            before = process.memory_info().rss
            began = time.perf_counter()
            all_answered = asyncio.Barrier(streams)
            work = asyncio.gather(
                *(_stream(stub, targets[k], scans[k % len(scans)], all_answered) for k in range(streams))
            )
            peak = before
            while not work.done():
                await asyncio.wait([work], timeout=_POLL)
                peak = max(peak, process.memory_info().rss)
            await work
            seconds = time.perf_counter() - began
            after = process.memory_info().rss
    finally:
        await registrar.stop()
    return {
        "streams": float(streams),
        "scans a stream": float(SCANS),
        "scene on the wire MB": float(np.mean([target.ByteSize() for target in targets])) / 1e6,
        "before MB": before / 1e6,
        "peak MB": peak / 1e6,
        "after MB": after / 1e6,
        "peak above before, MB a stream": (peak - before) / 1e6 / streams,
        "after above before, MB a stream": (after - before) / 1e6 / streams,
        "seconds": seconds,
    }


async def _stream(stub: RegistrarServiceStub, target: Scene, scans: list[Scan], all_answered: asyncio.Barrier) -> None:
    """One stream, held open until all have their last answer."""
    data = target.SerializeToString()
    answered = asyncio.Event()

    async def steps() -> AsyncIterator[RegisterStreamRequest]:
        yield RegisterStreamRequest(header=RegisterStreamHeader(scene_bytes=len(data)))
        for at in range(0, len(data), _CHUNK):
            yield RegisterStreamRequest(scene_chunk=data[at : at + _CHUNK])
        for scan in scans:
            yield RegisterStreamRequest(scan=scan)
        await answered.wait()
        await all_answered.wait()

    answers = 0
    async for _ in stub.RegisterStream(steps(), timeout=_TIMEOUT):
        answers += 1
        if answers == len(scans):
            answered.set()


def _scene(case: Case, number: int) -> View:
    """The case's view; those of different numbers differ, so that no stream profits from another's model."""
    table = Plane(TABLE.normal, TABLE.offset + 1e-6 * number)
    return View(case.depth, case.camera, case.base_T_camera, case.mask, table).cropped(_MARGIN)[0]


def _scans(case: Case) -> list[Scan]:
    """Straight scans across the object, 35 mm above its top."""
    extents = case.world.bodies[0].mesh.extents
    reach = float(extents[:2].max()) / 2 + 0.03
    tip = np.tile(np.eye(4), (2, 1, 1))
    tip[:, :3, :3] = np.diag([1.0, -1.0, -1.0])
    scans = []
    for k in range(SCANS):
        along = np.array([np.cos(k), np.sin(k), 0.0])
        tip[:, :3, 3] = PLACE + np.outer([-reach, reach], along) + [0.0, 0.0, extents[2] + 0.035]
        path = Trajectory(np.array([0.0, 2 * reach / 0.05]), tip.copy())
        samples = scan_along(case.world, path, Sensor(), ThinBeam(), generator("memory", SEED, case.name, k))
        scans.append(scan_to_proto(samples.beams(Sensor())))
    return scans


if __name__ == "__main__":
    main()
