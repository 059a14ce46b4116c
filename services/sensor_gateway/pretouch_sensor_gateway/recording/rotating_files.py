"""Writes one device's recordings to a series of bounded files, and pauses while the disk is full or gone."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import structlog

from pretouch_sensor_gateway.recording.channels import Entry
from pretouch_sensor_gateway.recording.encoder import Encoder
from pretouch_sensor_gateway.recording.file import RecordingFile
from pretouch_sensor_gateway.recording.folder import Folder
from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.queue_items import (
    BatchItem,
    ConfigurationItem,
    EventItem,
    Item,
    PointsItem,
    StopItem,
    TipPosesItem,
)

RETRY_AFTER = 10.0
"""Seconds to wait after a write failed before the next try."""
_KEPT_EVENTS = 64
_KEPT_POSES = 64
"""Messages of tip poses kept until there is a file."""


@dataclass(frozen=True)
class Written:
    """How many measurements were written to a file, and how many were given up."""

    recorded: int
    unrecorded: int


class RotatingFiles:
    """Writes a device's queued items to files within the limits; blocks on the disk.

    One thread writes; any may read the attributes.

    A file is opened by the first batch, so that no file is empty; events wait for it. When a write fails, the file is
    truncated to its last whole record and abandoned, and a new one is tried after `RETRY_AFTER`.

    Attributes:
        path: the file being written, if any.
        problem: why nothing is recorded, "" if nothing is wrong.
    """

    def __init__(
        self,
        root: Path,
        device: str,
        limits: Limits,
        log: structlog.typing.FilteringBoundLogger,
        commit_every: float,
    ) -> None:
        self.problem = ""
        self._folder = Folder(root, device)
        self._device = device
        self._limits = limits
        self._log = log
        self._encoder = Encoder(device)
        self._file: RecordingFile | None = None
        self._file_began = 0
        self._started = False
        self._finished_bytes = self._count_bytes()
        self._events: deque[Entry] = deque(maxlen=_KEPT_EVENTS)
        self._poses: deque[list[Entry]] = deque(maxlen=_KEPT_POSES)  # with which the next file starts
        self._commit_every = commit_every
        self._commit_at = self._retry_at = -float("inf")
        self._recorded = self._unrecorded = self._uncommitted = self._missed = 0

    @property
    def path(self) -> Path | None:
        file = self._file  # once, for the event loop asks while the thread opens and ends files
        return file.path if file else None

    @property
    def bytes(self) -> int:
        """The size of all of the device's recordings."""
        file = self._file
        return self._finished_bytes + (file.size if file else 0)

    def write(self, items: Sequence[Item], now: float) -> Written:
        """Adds `items`, and writes all that was added if it is time to; `now` in s of any steady clock."""
        self._recorded = self._unrecorded = 0
        for item in items:
            try:
                self._write_item(item, now)
            except Exception as error:
                self._pause(error, now)
                if isinstance(item, BatchItem):
                    self._give_up(item.measurements)
        if now >= self._commit_at:
            try:
                self._commit()
            except Exception as error:
                self._pause(error, now)
            self._commit_at = now + self._commit_every
        return Written(self._recorded, self._unrecorded)

    def _write_item(self, item: Item, now: float) -> None:
        match item:
            case BatchItem() if now < self._retry_at:
                self._give_up(item.measurements)
            case BatchItem():
                entries = self._encoder.encode_batch(item.batch)
                self._end_full_file(entries)
                self._file = self._file or self._open_file(entries[0].time)
                for entry in entries:
                    self._file.add(entry)
                self._uncommitted += item.measurements
            case ConfigurationItem():
                self._add(self._encoder.encode_cloud())
                self._encoder.set_configuration(item.configuration)
                if self._file:
                    self._add(self._encoder.encode_configuration(self._encoder.nanoseconds(item.at)))
            case TipPosesItem():
                poses = self._encoder.encode_tip_poses(item.poses)
                if self._add(poses):
                    self._poses.clear()
                self._poses.append(poses)
            case PointsItem():
                self._add([self._encoder.encode_points(item.fused)])
            case EventItem():
                event = self._encoder.encode_event(item.text, self._encoder.nanoseconds(item.at))
                if not self._add([event]):
                    self._events.append(event)
            case StopItem():
                self._add(self._encoder.encode_cloud())
                self._finish_file()
                self._started = False
                self._poses.clear()
                self.problem, self._missed, self._retry_at = "", 0, -float("inf")

    def _add(self, entries: Sequence[Entry]) -> bool:
        """Adds entries to the open file; False if there is none."""
        if entries:
            self._end_full_file(entries)
        if self._file is None:
            return False
        for entry in entries:
            self._file.add(entry)
        return True

    def _end_full_file(self, entries: Sequence[Entry]) -> None:
        if self._file and (
            self._file.size_with(entries) > self._limits.file_bytes
            or abs(entries[0].time - self._file_began) > self._limits.file_seconds * 1e9
        ):
            self._finish_file()

    def _open_file(self, time: int) -> RecordingFile:
        path = self._folder.new_path(time)
        self._folder.prune(self._limits.total_bytes - self._limits.file_bytes)
        self._finished_bytes = self._folder.bytes()
        file = RecordingFile(path, self._device)
        self._file_began = time
        for entry in self._encoder.encode_configuration(time):
            file.add(entry)
        if not self._started:
            file.add(self._encoder.encode_event("recording started", time))
            self._started = True
        for poses in self._poses:
            for entry in poses:
                file.add(entry)
        while self._events:
            file.add(self._events.popleft())
        if self._missed:
            text = f"recording goes on; {self._missed} frames were not recorded: {self.problem}"
            file.add(self._encoder.encode_event(text, time))
        return file

    def _commit(self) -> None:
        if not self._file:
            return
        self._file.commit()
        self._recorded += self._uncommitted
        self._uncommitted = 0
        if self.problem:
            self._log.info("recording goes on", path=str(self._file.path), unrecorded=self._missed)
            self.problem, self._missed = "", 0

    def _finish_file(self) -> None:
        if not self._file:
            return
        self._commit()
        self._file.finish()
        self._finished_bytes += self._file.size
        self._file = None

    def _pause(self, error: Exception, now: float) -> None:
        file, self._file = self._file, None
        if file:
            file.abandon()
            self._finished_bytes += file.size
        self._give_up(self._uncommitted)
        self._uncommitted = 0
        self._retry_at = now + RETRY_AFTER
        reason = (error.strerror or str(error)) if isinstance(error, OSError) else "a defect of pretouch, see the log"
        where = file.path if file else self._folder.path
        if not self.problem:
            self._log.warning(
                "recording is paused", path=str(where), reason=reason, exc_info=not isinstance(error, OSError)
            )
        self.problem = f"Recording is paused, {where}: {reason}. It is tried again every {RETRY_AFTER:.0f} s."

    def _give_up(self, measurements: int) -> None:
        self._unrecorded += measurements
        self._missed += measurements

    def _count_bytes(self) -> int:
        try:
            return self._folder.bytes()
        except OSError:
            return 0
