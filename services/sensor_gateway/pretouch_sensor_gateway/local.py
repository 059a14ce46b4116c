"""A gateway for one device and one program: it starts with the program's need of it, and ends with it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from pretouch.errors import DeadlineExceeded, Unavailable
from pretouch_sensor_gateway.configuration import DEFAULT_BAUD, VARIABLE, DeviceSetting
from pretouch_sensor_gateway.wire_formats.recognition import AUTO

DEVICE = "finger"
"""What the device is called."""
_GRACE = 0.5
"""Seconds that calls get to end."""
_GATEWAY = (sys.executable, "-P", "-m", "pretouch", "serve", "gateway", "--until-stdin-closes")
_START_TIMEOUT = 60.0
_END_TIMEOUT = 10.0


@contextmanager
def local_gateway(address: str, wire_format: str = AUTO, baud: int = DEFAULT_BAUD) -> Iterator[str]:
    """Serves the device at `address` on a free port of 127.0.0.1; gives host:port of gRPC.

    The gateway is a process of its own, so that whatever keeps this one busy does not keep it from reading the port in
    time; it ends with this one, however that ends. What it logs as an error is printed to standard error afterwards,
    the rest is dropped: the device's status tells what is wrong with it.

    Raises:
        InvalidInput: address, format or baud rate cannot be.
        Unavailable: the gateway did not start.
        DeadlineExceeded: it did not start in a minute.
    """
    setting = DeviceSetting(DEVICE, address, wire_format, baud)
    with tempfile.TemporaryDirectory(prefix="pretouch-") as folder:
        configuration = Path(folder) / "gateway.toml"
        configuration.write_text(_configuration(setting))
        process = subprocess.Popen(
            [*_GATEWAY, "--port", "0", "--grace", str(_GRACE)],
            env=_environment() | {VARIABLE: str(configuration)},
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C reaches this program alone, which ends the gateway in order
        )
        log = _Log(process)
        try:
            yield log.ready()
        finally:
            _end(process)
            log.close()


def _configuration(setting: DeviceSetting) -> str:
    """What the gateway reads; JSON's strings are TOML's too."""
    recording = setting.recording
    address = setting.address if recording is None else f"replay:{recording.resolve()}"
    members = {"address": address, "format": setting.wire_format, "baud": setting.baud}
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in members.items())
    return "\n".join((f"[devices.{setting.name}]", *lines, ""))


def _environment() -> dict[str, str]:
    """This process's, without what was said to another gateway or to its clients."""
    return {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}


def _end(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        process.stdin.close()
    try:
        process.wait(_END_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class _Log:
    """Reads a gateway's log for as long as it runs."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        self._errors: list[str] = []
        self._address: Future[str] = Future()
        self._thread = threading.Thread(target=self._read, args=(process.stderr,), name="gateway log", daemon=True)
        self._thread.start()

    def ready(self) -> str:
        """host:port, once it serves."""
        try:
            return self._address.result(_START_TIMEOUT)
        except TimeoutError as error:
            raise DeadlineExceeded("The gateway for the device did not start in time.", "Try again.") from error

    def close(self) -> None:
        """Prints the errors; the gateway has ended."""
        self._thread.join(_END_TIMEOUT)
        sys.stderr.write("".join(self._errors))

    def _read(self, stream: IO[bytes]) -> None:
        with stream:
            for line in stream:
                self._take(line.decode(errors="replace"))
        if not self._address.done():
            told, self._errors = "".join(self._errors).strip()[-500:], []
            self._address.set_exception(Unavailable(f"The gateway for the device did not start: {told}"))

    def _take(self, line: str) -> None:
        fields: Any = None
        with suppress(ValueError):
            fields = json.loads(line)
        if not isinstance(fields, dict) or fields.get("level") in ("error", "critical"):
            self._errors.append(line)
        elif fields.get("event") == "ready":
            self._address.set_result(f"{fields['host']}:{fields['port']}")
