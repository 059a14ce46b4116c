"""How much memory each service takes at most under the worst legal requests, all at once; and that all are answered.

    python -m benchmarks.memory_ceiling --memory 1500M

Twelve images of four megapixels are posted at once, obeying Retry-After; then registrar, detector and gateway are
called directly, twelve calls at once each, with messages as large as gRPC lets through.
"""

from __future__ import annotations

import argparse
import io
import json
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import httpx
import numpy as np
import psutil
from numpy.typing import NDArray
from PIL import Image
from pretouch_simulation.services import Services

from pretouch.camera import Camera, DepthImage
from pretouch.channel import open_sync_channel
from pretouch.errors import Overloaded, Unavailable, from_rpc_error
from pretouch.geometry import Plane, Pose
from pretouch.scene import Scene
from pretouch.tof import Scan
from pretouch.v1 import detector_pb2, registrar_pb2
from pretouch.v1 import sensor_gateway_pb2 as gateway_pb2
from pretouch.v1.detector_pb2_grpc import DetectorServiceStub
from pretouch.v1.registrar_pb2_grpc import RegistrarServiceStub
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub
from pretouch.wire.common import scan_to_proto, scene_to_proto

AT_ONCE = 12
SIDE, FOCAL = 2000, 1640.0
SAMPLES, SCANS = 20_000, 9
_PATIENCE = 600.0  # s


def see_box(seed: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Depth, m, and mask of a box of 30 cm on a table, from 1 m above it."""
    depth = np.full((SIDE, SIDE), 1.0, np.float32)
    mask = np.zeros((SIDE, SIDE), bool)
    half = int(0.15 * FOCAL)
    mask[SIDE // 2 - half : SIDE // 2 + half, SIDE // 2 - half : SIDE // 2 + half] = True
    depth[mask] = 0.9
    depth += np.random.default_rng(seed).normal(0.0, 0.001, depth.shape).astype(np.float32)
    return depth, mask


def make_scene(seed: int) -> Scene:
    """The same as a scene."""
    depth, mask = see_box(seed)
    camera = Camera(FOCAL, FOCAL, (SIDE - 1) / 2, (SIDE - 1) / 2)
    above = Pose.of(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 1.0])
    return Scene(DepthImage(depth), camera, above, mask, Plane(np.array([0.0, 0.0, 1.0]), 0.0))


def make_creation(seed: int) -> dict[str, tuple[str, bytes, str]]:
    """The parts of a session's creation."""
    depth, mask = see_box(seed)
    npy, png = io.BytesIO(), io.BytesIO()
    np.save(npy, depth)
    Image.fromarray(mask.astype(np.uint8) * 255).save(png, format="PNG")
    request = {
        "camera": {"fx": FOCAL, "fy": FOCAL, "cx": (SIDE - 1) / 2, "cy": (SIDE - 1) / 2, "depth_scale": 1.0},
        "base_T_camera": {"translation": [0.0, 0.0, 1.0], "rotation": [1.0, 0.0, 0.0, 0.0]},
    }
    return {
        "request": ("request.json", json.dumps(request).encode(), "application/json"),
        "depth": ("depth.npy", npy.getvalue(), "application/octet-stream"),
        "mask": ("mask.png", png.getvalue(), "image/png"),
    }


def create(rest: str, seed: int) -> str:
    """Creates a session, again when it was too busy; what came of it."""
    parts, until = make_creation(seed), time.monotonic() + _PATIENCE
    while True:
        try:
            answer = httpx.post(f"{rest}/v1/sessions", files=parts, timeout=_PATIENCE)
        except httpx.TransportError as error:
            return type(error).__name__
        if answer.status_code not in (429, 503, 504) or time.monotonic() > until:
            return str(answer.status_code)
        time.sleep(float(answer.headers.get("retry-after", 1)))


def call(method: Any, request: Any) -> str:
    """Calls a service, again while it is busy; the status."""
    until = time.monotonic() + _PATIENCE
    while True:
        try:
            method(request, timeout=_PATIENCE)
        except grpc.RpcError as error:
            kind = from_rpc_error(error)
            if not isinstance(kind, Overloaded | Unavailable) or time.monotonic() > until:
                return type(kind).__name__
        else:
            return "OK"
        time.sleep(1.0)


def make_scan(seed: int) -> Scan:
    """As many samples as a scan may have, over the box."""
    rng = np.random.default_rng(seed)
    origins = np.column_stack([rng.uniform(-0.2, 0.2, (SAMPLES, 2)), np.full(SAMPLES, 0.13)])
    return Scan(origins, np.tile([0.0, 0.0, -1.0], (SAMPLES, 1)), np.full(SAMPLES, 0.03))


def find_services() -> dict[str, psutil.Process]:
    """The services' processes by name."""
    found = {}
    for process in psutil.Process().children(recursive=True):
        words = process.cmdline()
        if "serve" in words:
            found[words[words.index("serve") + 1]] = process
    return found


def read_memory(process: psutil.Process, field: str) -> float:
    """MiB: `VmRSS`, held now, or `VmHWM`, held at most."""
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--memory", default="1500M", help="PRETOUCH_MEMORY of each service")
    memory = parser.parse_args().memory
    with Services(environment={"PRETOUCH_MEMORY": memory}) as services, ThreadPoolExecutor(AT_ONCE) as pool:
        processes = find_services()
        idle = {name: read_memory(process, "VmRSS") for name, process in processes.items()}

        def all_at_once(name: str, ask: Callable[[int], str]) -> None:
            began = time.monotonic()
            outcomes = Counter(pool.map(ask, range(AT_ONCE)))
            print(f"{name:28} {time.monotonic() - began:6.1f} s  {dict(outcomes)}", flush=True)

        def ask_directly(name: str, stub: Any, method: str, make: Callable[[int], Any]) -> None:
            (port,) = {each.laddr.port for each in processes[name].net_connections() if each.status == "LISTEN"}
            with open_sync_channel(f"127.0.0.1:{port}") as channel:
                ask = getattr(stub(channel), method)
                all_at_once(f"{name} {method}", lambda seed: call(ask, make(seed)))

        all_at_once("creations of 4 MP", lambda seed: create(services.rest, seed))
        scene = scene_to_proto(make_scene(0))
        scans = [scan_to_proto(make_scan(seed)) for seed in range(SCANS)]
        ask_directly(
            "registrar",
            RegistrarServiceStub,
            "Register",
            lambda seed: registrar_pb2.RegisterRequest(scene=scene_to_proto(make_scene(seed)), scans=scans),
        )
        ask_directly(
            "detector",
            DetectorServiceStub,
            "Propose",
            lambda seed: detector_pb2.ProposeRequest(scene=scene, seed=seed),
        )
        ask_directly(
            "gateway",
            SensorGatewayServiceStub,
            "GetSamples",
            lambda seed: gateway_pb2.GetSamplesRequest(device="x" * (31 << 20)),
        )
        for name, process in processes.items():
            print(f"{name:14} {idle[name]:6.0f} MiB idle, {read_memory(process, 'VmHWM'):6.0f} MiB at most")


if __name__ == "__main__":
    main()
