"""Queues what one device records, on the event loop; never blocks and never fails."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import structlog

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.recording.queue_items import (
    BatchItem,
    ConfigurationItem,
    EventItem,
    Item,
    PointsItem,
    StopItem,
    TipPosesItem,
)
from pretouch_sensor_gateway.recording.rotating_files import RotatingFiles

QUEUE_BATCHES = 1024
"""Batches that may wait for the disk: half a minute at 30 Hz. While so many wait, new ones are not recorded."""
_TOO_SLOW = "The disk is too slow: not everything is recorded."
_TIME_OF_LAST_BATCH = float("nan")  # an event with this time gets that of the batch before


@dataclass(frozen=True)
class RecordingStatus:
    """The status of a recording. Every measurement while recording is in exactly one of the three counts.

    Attributes:
        on: whether the device is recorded.
        path: the file being written, "" if none.
        bytes: of all of this device's recordings.
        measurements: recorded since the gateway started.
        unrecorded: measurements that could not be recorded: the disk was full, or too slow.
        pending: measurements that wait for the disk; none when the recorder is idle.
        problem: what is wrong, "" if nothing is.
    """

    on: bool
    path: str
    bytes: int
    measurements: int
    unrecorded: int
    pending: int
    problem: str


class Recorder:
    """Created by `RecordingWriter.create_recorder`; starts switched off.

    Args:
        files: the device's files, which the writer thread writes.
        wake: wakes the writer thread.
    """

    def __init__(
        self, files: RotatingFiles, wake: Callable[[], None], log: structlog.typing.FilteringBoundLogger
    ) -> None:
        self._log = log
        self._files = files
        self._wake = wake
        self._lock = threading.Lock()
        self._items: list[Item] = []
        self._batches = 0
        self._on = False
        self._overflowed = 0
        self._measurements = self._unrecorded = self._pending = 0

    @property
    def on(self) -> bool:
        """Whether the device is recorded."""
        return self._on

    def start(self) -> None:
        """Records from the next batch on."""
        self._on = True

    def stop(self) -> None:
        """Ends the recording; its file is finished soon after."""
        if self._on:
            self._on = False
            self._enqueue(StopItem())

    def record_batch(self, batch: pb.RangeBatch) -> None:
        """Records `batch`, which must not be changed afterwards."""
        if not self._on:
            return
        measurements = batch.t.shape[0] if batch.t.shape else 0
        with self._lock:
            if self._batches >= QUEUE_BATCHES:
                self._unrecorded += measurements
                self._overflowed += measurements
                return
            self._items.append(BatchItem(batch, measurements))
            self._batches += 1
            self._pending += measurements
        self._wake()

    def record_configuration(self, configuration: pb.DeviceConfiguration, at: float) -> None:
        """Records the configuration that holds from Unix time `at`, s; it must not be changed afterwards.

        To be called before the first batch and whenever it changes, while recording or not.
        """
        self._enqueue(ConfigurationItem(configuration, at))

    def record_fusion(self, item: TipPosesItem | PointsItem) -> None:
        """Records tip poses or the points that came of them, unless the disk hangs."""
        if self._on and len(self._items) < 4 * QUEUE_BATCHES:
            self._enqueue(item)

    def record_event(self, text: str, at: float) -> None:
        """Records an event at Unix time `at`, s."""
        if self._on:
            self._enqueue(EventItem(text, at))

    def status(self) -> RecordingStatus:
        path = self._files.path
        with self._lock:
            return RecordingStatus(
                on=self._on,
                path=str(path) if path else "",
                bytes=self._files.bytes,
                measurements=self._measurements,
                unrecorded=self._unrecorded,
                pending=self._pending,
                problem=(self._files.problem or (_TOO_SLOW if self._overflowed else "")) if self._on else "",
            )

    def write_pending(self, now: float) -> None:
        """Passes everything queued so far, perhaps nothing, to the files; `now` in s of any steady clock.

        Called by the writer thread.
        """
        with self._lock:
            items, self._items = self._items, []
            overflowed, self._overflowed = self._overflowed, 0
            self._batches = 0
        if overflowed:
            self._log.warning("the disk is too slow to record all", frames=overflowed)
            last = max(index for index, item in enumerate(items) if isinstance(item, BatchItem))
            text = f"{overflowed} frames were not recorded: the disk is too slow"
            items.insert(last + 1, EventItem(text, _TIME_OF_LAST_BATCH))
        written = self._files.write(items, now)
        with self._lock:
            self._measurements += written.recorded
            self._unrecorded += written.unrecorded
            self._pending -= written.recorded + written.unrecorded

    def _enqueue(self, item: Item) -> None:
        with self._lock:
            self._items.append(item)
        self._wake()
