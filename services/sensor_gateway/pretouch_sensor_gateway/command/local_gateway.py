"""Runs a gateway process of its own for one device, for as long as a command needs it."""

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
from pretouch_sensor_gateway.configuration import VARIABLE, DeviceSetting
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO

DEVICE = "finger"
"""The device's name in the local gateway."""
_GRACE = 0.5
"""Seconds that calls get to end when the gateway shuts down."""
_GATEWAY = (sys.executable, "-P", "-m", "pretouch", "serve", "gateway", "--until-stdin-closes")
_START_TIMEOUT = 60.0
_END_TIMEOUT = 10.0


@contextmanager
def run_local_gateway(address: str, wire_format: str = AUTO, baud: int = DEFAULT_BAUD) -> Iterator[str]:
    """Runs a gateway for the device at `address` on a free port of 127.0.0.1; yields host:port of its gRPC server.

    The gateway is a separate process, so that it reads the port in time however busy this process is. It ends with this
    process, however that ends. Errors that it logs are printed to standard error afterwards; the rest is dropped: the
    device's status says what is wrong.

    Raises:
        InvalidInput: address, format or baud rate is invalid.
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
        log = _LogReader(process)
        try:
            yield log.wait_until_ready()
        finally:
            _stop(process)
            log.close()


def _configuration(setting: DeviceSetting) -> str:
    """The gateway's TOML file; JSON strings are valid TOML strings."""
    recording = setting.recording
    address = setting.address if recording is None else f"replay:{recording.resolve()}"
    members = {"address": address, "format": setting.wire_format, "baud": setting.baud}
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in members.items())
    return "\n".join((f"[devices.{setting.name}]", *lines, ""))


def _environment() -> dict[str, str]:
    """This process's environment without pretouch's own variables: they are meant for other services."""
    return {key: value for key, value in os.environ.items() if not key.startswith("PRETOUCH_")}


def _stop(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None
    with suppress(BrokenPipeError):
        process.stdin.close()
    try:
        process.wait(_END_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class _LogReader:
    """Reads a gateway's log for as long as it runs."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        self._errors: list[str] = []
        self._address: Future[str] = Future()
        self._thread = threading.Thread(target=self._read, args=(process.stderr,), name="gateway log", daemon=True)
        self._thread.start()

    def wait_until_ready(self) -> str:
        """host:port, once the gateway serves."""
        try:
            return self._address.result(_START_TIMEOUT)
        except TimeoutError as error:
            raise DeadlineExceeded("The gateway for the device did not start in time.", "Try again.") from error

    def close(self) -> None:
        """Prints the errors, once the gateway has ended."""
        self._thread.join(_END_TIMEOUT)
        sys.stderr.write("".join(self._errors))

    def _read(self, stream: IO[bytes]) -> None:
        with stream:
            for line in stream:
                self._handle(line.decode(errors="replace"))
        if not self._address.done():
            output, self._errors = "".join(self._errors).strip()[-500:], []
            self._address.set_exception(Unavailable(f"The gateway for the device did not start: {output}"))

    def _handle(self, line: str) -> None:
        fields: Any = None
        with suppress(ValueError):
            fields = json.loads(line)
        if not isinstance(fields, dict) or fields.get("level") in ("error", "critical"):
            self._errors.append(line)
        elif fields.get("event") == "ready":
            self._address.set_result(f"{fields['host']}:{fields['port']}")
