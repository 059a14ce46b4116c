"""The gateway as a separate process, and its resource usage."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pretouch_sensor_gateway.configuration import VARIABLE

from benchmarks.gateway_fingers import MODULES
from benchmarks.gateway_usage import Usage, usage_of
from pretouch.channel import open_sync_channel
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.v1.sensor_gateway_pb2_grpc import SensorGatewayServiceStub

_TIMEOUT = 60.0


class GatewayProcess:
    """`pretouch serve gateway` with a device of `MODULES` modules on each of `ports`; a context manager.

    Args:
        recordings: folder to record all devices to; None: nothing is recorded.

    Attributes:
        devices: their names.
    """

    def __init__(self, ports: Sequence[str], recordings: Path | None = None) -> None:
        self.devices = [f"finger{k}" for k in range(len(ports))]
        poses = ", ".join(f"{{ translation = [{0.01 * k:g}, 0, 0], rotation = [0, 0, 0, 1] }}" for k in range(MODULES))
        self._configuration = "" if recordings is None else f'recordings = "{recordings}"\n'
        for name, port in zip(self.devices, ports, strict=True):
            self._configuration += f'[devices.{name}]\naddress = "{port}"\nmodules = [{poses}]\n'
            self._configuration += "record = true\n" if recordings is not None else ""
        self._log: list[str] = []
        self._ready = threading.Event()
        self._port = 0

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._port}"

    def usage(self) -> Usage:
        return usage_of(self._process.pid)

    def statuses(self) -> list[pb.GetStatusResponse]:
        """Of all devices."""
        return [self._stub.GetStatus(pb.GetStatusRequest(device=name), timeout=_TIMEOUT) for name in self.devices]

    def __enter__(self) -> GatewayProcess:
        """Returns once it serves.

        Raises:
            RuntimeError: it ended at once, or does not serve.
        """
        with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
            file.write(self._configuration)
            file.flush()
            kept = {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "pretouch", "serve", "gateway", "--port", "0", "--until-stdin-closes"],
                env=kept | {VARIABLE: file.name},
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
            )
            self._reader = threading.Thread(target=self._follow, daemon=True)
            self._reader.start()
            if not self._ready.wait(_TIMEOUT) or not self._port:
                self.__exit__()
                raise RuntimeError("the gateway does not serve:\n" + "".join(self._log[-5:]))
        self._channel = open_sync_channel(self.address)
        self._stub: Any = SensorGatewayServiceStub(self._channel)
        return self

    def __exit__(self, *_: object) -> None:
        if self._port:
            self._channel.close()
        self._process.terminate()
        try:
            self._process.wait(_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stderr):
            assert pipe is not None
            pipe.close()

    def _follow(self) -> None:
        assert self._process.stderr is not None
        for raw in self._process.stderr:
            self._log = [*self._log[-99:], raw.decode(errors="replace")]
            try:
                fields = json.loads(raw)
            except ValueError:
                continue
            if fields.get("event") == "ready":
                self._port = int(fields["port"])
                self._ready.set()
        self._ready.set()
