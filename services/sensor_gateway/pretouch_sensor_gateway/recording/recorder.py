"""The recording of one device, as the event loop sees it: it never blocks and never fails."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import structlog

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch_sensor_gateway.recording.queue_items import BatchItem, ConfigurationItem, EventItem, Item, StopItem
from pretouch_sensor_gateway.recording.rotating_files import RotatingFiles

QUEUE_BATCHES = 1024
"""Batches that wait for the disk: half a minute at 30 Hz. While as many wait, new ones are not recorded."""
_TOO_SLOW = "The disk is too slow: not everything is recorded."
_AT_THAT_TIME = float("nan")  # an event's time that means: that of the batch before


@dataclass(frozen=True)
class RecordingStatus:
    """What is being recorded. Every frame given while recording is in exactly one of the three counts.

    Attributes:
        on: whether the device is recorded.
        path: the file being written, "" if none.
        bytes: of all of this device's recordings.
        frames: recorded since the gateway started.
        unrecorded: frames that could not be recorded: the disk was full, or too slow.
        pending: frames that wait for the disk; none when the recorder is idle.
        problem: what is wrong, "" if nothing is.
    """

    on: bool
    path: str
    bytes: int
    frames: int
    unrecorded: int
    pending: int
    problem: str


class Recorder:
    """Made by `RecordingWriter.recorder`; starts switched off.

    Args:
        files: where the writer's thread writes.
        wake: tells that thread that there is something to write.
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
        self._frames = self._unrecorded = self._pending = 0

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
            self._hand_over(StopItem())

    def record_batch(self, batch: pb.RangeBatch) -> None:
        """Records `batch`, which must not change any more."""
        if not self._on:
            return
        frames = batch.t.shape[0] if batch.t.shape else 0
        with self._lock:
            if self._batches >= QUEUE_BATCHES:
                self._unrecorded += frames
                self._overflowed += frames
                return
            self._items.append(BatchItem(batch, frames))
            self._batches += 1
            self._pending += frames
        self._wake()

    def record_configuration(self, configuration: pb.DeviceConfiguration, at: float) -> None:
        """The configuration that holds from `at`, s since the Unix epoch; tell it before the first batch, and when it
        changes, recording or not. It must not change any more.
        """
        self._hand_over(ConfigurationItem(configuration, at))

    def record_event(self, text: str, at: float) -> None:
        """Records that something happened, `at` in s since the Unix epoch."""
        if self._on:
            self._hand_over(EventItem(text, at))

    def status(self) -> RecordingStatus:
        path = self._files.path
        with self._lock:
            return RecordingStatus(
                on=self._on,
                path=str(path) if path else "",
                bytes=self._files.bytes,
                frames=self._frames,
                unrecorded=self._unrecorded,
                pending=self._pending,
                problem=(self._files.problem or (_TOO_SLOW if self._overflowed else "")) if self._on else "",
            )

    def write_pending(self, now: float) -> None:
        """For the writer's thread: writes what was handed over so far; `now` in s of any steady clock."""
        with self._lock:
            items, self._items = self._items, []
            overflowed, self._overflowed = self._overflowed, 0
            self._batches = 0
        if not items:
            return
        if overflowed:
            self._log.warning("the disk is too slow to record all", frames=overflowed)
            last = max(index for index, item in enumerate(items) if isinstance(item, BatchItem))
            text = f"{overflowed} frames were not recorded: the disk is too slow"
            items.insert(last + 1, EventItem(text, _AT_THAT_TIME))
        written = self._files.write(items, now)
        with self._lock:
            self._frames += written.recorded
            self._unrecorded += written.unrecorded
            self._pending -= written.recorded + written.unrecorded

    def _hand_over(self, item: Item) -> None:
        with self._lock:
            self._items.append(item)
        self._wake()
