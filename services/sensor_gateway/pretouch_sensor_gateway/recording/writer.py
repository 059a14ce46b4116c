"""Writes the recordings of all devices, in one thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

import structlog

from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.recorder import Recorder
from pretouch_sensor_gateway.recording.rotating_files import RotatingFiles

COMMIT_EVERY = 2.0
"""Seconds between two writes to a file, each one compressed chunk: what a crash may cost."""
_GATHER = 0.005
"""Seconds that a batch waits to be encoded: subscribers get it first."""
_LAST_WRITE = 10.0
"""Seconds that the gateway's shutdown waits for a disk that hangs."""


class RecordingWriter:
    """Writes each device's recordings to a folder of `root`, from entering a `with` block to its end.

    One thread serves all devices: it encodes what each has queued, and writes it every `commit_every`. Leaving the
    block finishes all files.

    Args:
        root: the folder with one folder for each device; created if it does not exist.
        limits: of each device.
        clock: a steady clock, s.
        commit_every: s between two writes to a file.
    """

    def __init__(
        self,
        root: Path,
        log: structlog.typing.FilteringBoundLogger,
        limits: Limits | None = None,
        clock: Callable[[], float] = time.monotonic,
        commit_every: float = COMMIT_EVERY,
    ) -> None:
        self._root = root
        self._log = log
        self._limits = limits or Limits()
        self._clock = clock
        self._commit_every = commit_every
        self._recorders: tuple[Recorder, ...] = ()
        self._something_to_write = threading.Event()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    def create_recorder(self, device: str) -> Recorder:
        """Creates a recorder of `device`.

        Raises:
            InvalidInput: the device's name cannot be the name of a folder.
        """
        log = self._log.bind(device=device)
        files = RotatingFiles(self._root, device, self._limits, log, self._commit_every)
        recorder = Recorder(files, self._something_to_write.set, log)
        self._recorders += (recorder,)
        return recorder

    def __enter__(self) -> Self:
        """Starts the thread.

        Raises:
            OSError: `root` cannot be created.
        """
        self._root.mkdir(parents=True, exist_ok=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Finishes all files; returns within seconds even if the disk hangs."""
        for recorder in self._recorders:
            recorder.stop()
        self._ending = True
        self._something_to_write.set()
        self._thread.join(_LAST_WRITE)
        if self._thread.is_alive():
            pending = sum(recorder.status().pending for recorder in self._recorders)
            self._log.warning("the disk hangs: the last frames are not recorded", root=str(self._root), frames=pending)

    def _run(self) -> None:
        ending = False
        while not ending:
            self._something_to_write.wait(COMMIT_EVERY)
            time.sleep(_GATHER)
            self._something_to_write.clear()
            ending = self._ending
            for recorder in self._recorders:
                recorder.write_pending(self._clock())
