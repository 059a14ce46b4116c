"""The parent's side of a simulated finger: starts its process, announces motions to it, ends it."""

from __future__ import annotations

import json
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from pretouch.errors import DeadlineExceeded, Unavailable
from pretouch.interrupts import interrupts_held_back
from pretouch.trajectory import Trajectory

_START_TIMEOUT = 60.0  # loading numba from a cold disk, and compiling the ray caster once
_END_TIMEOUT = 5.0


class FingerProcess:
    """A running finger process; a context manager.

    Args:
        command: a program that behaves as `pretouch_simulation.finger_process` does.

    Attributes:
        port: path of the serial port, for the gateway; known once started.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None
        self.port = ""

    @staticmethod
    def in_world(world: Path, sensor: str = "ideal", seed: int = 0, rate: float = 30.0) -> FingerProcess:
        """A finger in a world that `World.save` wrote, realised by generator("finger-model", seed); `rate` in Hz."""
        options = {"--world": world, "--sensor": sensor, "--seed": seed, "--rate": rate}
        pairs = [str(part) for option in options.items() for part in option]
        return FingerProcess([sys.executable, "-m", "pretouch_simulation.finger_process", *pairs])

    def start(self) -> None:
        """Starts the process and waits until its port is there.

        Raises:
            Unavailable: it ended at once; the error says what it printed.
            DeadlineExceeded: it did not open its port in a minute.
        """
        with tempfile.TemporaryFile() as errors:
            try:
                with interrupts_held_back():
                    self._process = process = subprocess.Popen(
                        self._command,
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        stderr=errors,
                        start_new_session=True,  # a Ctrl-C in a terminal is this process's, which ends the finger
                    )
                assert process.stdout is not None
                ready, _, _ = select.select([process.stdout], [], [], _START_TIMEOUT)
                line = process.stdout.readline() if ready else b""
            except KeyboardInterrupt:
                self.close()
                raise
            if not line:
                self.close()
                errors.seek(0)
                said = errors.read().decode(errors="replace").strip()[-500:]
                if not ready:
                    raise DeadlineExceeded("The simulated finger did not start in time.", said or "Try again.")
                raise Unavailable(f"The simulated finger did not start: {said}", "Mend what it says.")
        self.port = json.loads(line)["port"]

    def play(self, trajectory: Trajectory, start: float | None = None) -> None:
        """Announces that the tip will be at `trajectory`'s pose of time t at `start` + t; the default is from now on.

        Args:
            start: s since the Unix epoch.

        Raises:
            Unavailable: the process has ended.
        """
        announcement = {
            "start": time.time() if start is None else start,
            "t": trajectory.t.tolist(),
            "base_T_tip": trajectory.base_T_tip.reshape(-1, 16).tolist(),
        }
        try:
            if self._process is None or self._process.stdin is None:
                raise BrokenPipeError
            self._process.stdin.write(json.dumps(announcement).encode() + b"\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError) as error:
            raise Unavailable("The simulated finger has ended.", "Start it again.") from error

    def close(self) -> None:
        """Ends the process; harmless when it has ended."""
        if self._process is None:
            return
        process, self._process, self.port = self._process, None, ""
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def __enter__(self) -> FingerProcess:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
