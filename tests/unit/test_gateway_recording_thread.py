"""One thread writes for all devices; whoever hands batches over never waits, and every frame is counted."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import structlog
from helpers.gateway_recordings import T0, files_in, log_in, made_batch, made_configuration, recorded_in, sequence_in
from pretouch_sensor_gateway.recording import writer as writer_module
from pretouch_sensor_gateway.recording.recorder import QUEUE_BATCHES, Recorder
from pretouch_sensor_gateway.recording.writer import RecordingWriter

from pretouch.recording.reader import RecordingReader

LOG = structlog.get_logger()


class Gate:
    """Stands in for `os.write`: while shut, the disk hangs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reached = threading.Event()
        self._open = threading.Event()
        self._open.set()
        self._write: Callable[[int, bytes], int] = os.write
        monkeypatch.setattr("pretouch_sensor_gateway.recording.file.os.write", self)

    def shut(self) -> None:
        self.reached.clear()
        self._open.clear()

    def open(self) -> None:
        self._open.set()

    def __call__(self, descriptor: int, data: bytes) -> int:
        self.reached.set()
        assert self._open.wait(60)
        return self._write(descriptor, data)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Gate:
    return Gate(monkeypatch)


def counted(recorder: Recorder) -> int:
    status = recorder.status()
    return status.measurements + status.unrecorded + status.pending


def test_64_devices_are_recorded_by_one_thread(tmp_path: Path) -> None:
    before = threading.active_count()
    with RecordingWriter(tmp_path / "new" / "root", LOG) as writer:
        recorders = [writer.create_recorder(f"finger-{n}") for n in range(64)]
        assert threading.active_count() == before + 1
        for recorder in recorders:
            recorder.record_configuration(made_configuration(), T0)
            recorder.start()
        for k in range(20):
            for n, recorder in enumerate(recorders):
                recorder.record_batch(made_batch(1000 * n + 2 * k, 2))
                assert counted(recorder) == 2 * k + 2
    assert threading.active_count() == before
    for n, recorder in enumerate(recorders):
        status = recorder.status()
        assert (status.on, status.measurements, status.unrecorded, status.pending) == (False, 40, 0, 0)
        (path,) = files_in(tmp_path / "new" / "root", f"finger-{n}")
        assert sequence_in(path) == list(range(1000 * n, 1000 * n + 40))
        assert {message.topic.split("/")[1] for message in recorded_in(path)} == {f"finger-{n}"}
        assert status.bytes == path.stat().st_size


def test_leaving_the_block_finishes_every_file(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, LOG) as writer:
        recorder = writer.create_recorder("left")
        recorder.start()
        for k in range(500):
            recorder.record_batch(made_batch(k))
    reader = RecordingReader(files_in(tmp_path)[0])
    assert [message.topic for message in reader].count("/left/ranges") == 500
    assert reader.complete


def test_only_what_comes_while_it_is_on_is_recorded(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path, LOG) as writer:
        recorder = writer.create_recorder("left")
        recorder.record_batch(made_batch(0))
        recorder.record_event("nobody listens", T0)
        assert recorder.status().on is False
        recorder.start()
        recorder.start()
        recorder.record_batch(made_batch(1))
        assert recorder.status().on is True
        recorder.stop()
        recorder.record_batch(made_batch(2))
        recorder.stop()
        recorder.start()
        recorder.record_batch(made_batch(3))
    assert [sequence_in(path) for path in files_in(tmp_path)] == [[1], [3]]
    assert [log_in(path) for path in files_in(tmp_path)] == [["recording started"]] * 2
    assert recorder.status().measurements == 2
    assert recorder.status().path == ""


def test_a_disk_that_hangs_costs_frames_but_no_time(tmp_path: Path, gate: Gate) -> None:
    with structlog.testing.capture_logs() as logs, RecordingWriter(tmp_path, LOG) as writer:
        left, right = writer.create_recorder("left"), writer.create_recorder("right")
        left.start()
        right.start()
        gate.shut()
        left.record_batch(made_batch(0))
        assert gate.reached.wait(60)
        for k in range(QUEUE_BATCHES + 100):
            left.record_batch(made_batch(1 + 2 * k, 2))
            assert counted(left) == 1 + 2 * (k + 1)
        right.record_batch(made_batch(0))
        assert (left.status().measurements, left.status().unrecorded) == (0, 200)
        assert "too slow" in left.status().problem
        assert right.status().problem == ""
        gate.open()
    assert (left.status().measurements, left.status().unrecorded, left.status().pending) == (
        1 + 2 * QUEUE_BATCHES,
        200,
        0,
    )
    assert right.status().measurements == 1
    (path,) = files_in(tmp_path)
    assert sequence_in(path) == list(range(1 + 2 * QUEUE_BATCHES))
    assert any("200 frames were not recorded" in text for text in log_in(path))
    assert [(entry["event"], entry["frames"]) for entry in logs] == [("the disk is too slow to record all", 200)]


def test_a_disk_that_hangs_for_good_does_not_keep_the_gateway_from_ending(
    tmp_path: Path, gate: Gate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "_LAST_WRITE", 0.01)
    with structlog.testing.capture_logs() as logs:
        with RecordingWriter(tmp_path, LOG) as writer:
            recorder = writer.create_recorder("left")
            recorder.start()
            gate.shut()
            recorder.record_batch(made_batch(0, 3))
            assert gate.reached.wait(60)
        assert [(entry["event"], entry["frames"]) for entry in logs] == [
            ("the disk hangs: the last frames are not recorded", 3)
        ]
    thread = next(thread for thread in threading.enumerate() if thread.name == "recording")
    gate.open()
    thread.join(60)
    assert recorder.status().measurements == 3


def test_a_full_disk_is_retried_by_the_writers_clock(tmp_path: Path) -> None:
    now = 0.0
    (tmp_path / "left").write_text("in the way")
    with RecordingWriter(tmp_path, LOG, clock=lambda: now, commit_every=0.0) as writer:
        recorder = writer.create_recorder("left")
        recorder.start()
        recorder.record_batch(made_batch(0))
        settled(recorder)
        assert "It is tried again" in recorder.status().problem
        (tmp_path / "left").unlink()
        now = 10.0
        recorder.record_batch(made_batch(1))
        settled(recorder)
        assert recorder.status().problem == ""
        assert recorder.status().path == str(files_in(tmp_path)[0])
    assert (recorder.status().measurements, recorder.status().unrecorded) == (1, 1)


def settled(recorder: Recorder) -> None:
    """Returns when nothing waits for the disk any more."""
    waiting = threading.Event()
    for _ in range(6000):
        if not recorder.status().pending:
            return
        waiting.wait(0.01)
    raise AssertionError("The writer's thread does nothing.")
