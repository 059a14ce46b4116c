"""Recordings are rotated, bounded, named in their order, and survive what a disk may do."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import pytest
import structlog
from helpers.gateway_recordings import files_in, log_in, measured, sequence_in, series_in
from pretouch_sensor_gateway.recording.limits import Limits
from pretouch_sensor_gateway.recording.queue_items import BatchItem, EventItem, Item, StopItem
from pretouch_sensor_gateway.recording.rotating_files import RETRY_AFTER, RotatingFiles

from pretouch.errors import InvalidInput
from pretouch.recording.reader import RecordingReader

SMALL = Limits(file_bytes=64 * 1024, total_bytes=200 * 1024)


def stopped(files: RotatingFiles) -> None:
    files.write([StopItem()], 0.0)


class TestRotation:
    def test_files_keep_to_their_size_and_their_end_and_lose_nothing(self, tmp_path: Path) -> None:
        files = series_in(tmp_path, Limits(file_bytes=64 * 1024))
        for k in range(400):
            files.write([measured(k)], 0.0)
        stopped(files)
        paths = files_in(tmp_path)
        assert len(paths) > 2
        assert all(path.stat().st_size <= 64 * 1024 for path in paths)
        assert [number for path in paths for number in sequence_in(path)] == list(range(400))
        assert all(is_complete(path) for path in paths)

    def test_a_file_ends_within_one_write_too(self, tmp_path: Path) -> None:
        files = series_in(tmp_path, Limits(file_bytes=64 * 1024))
        written = files.write([measured(k) for k in range(400)], 0.0)
        stopped(files)
        assert written.recorded == 400
        assert all(path.stat().st_size <= 64 * 1024 for path in files_in(tmp_path))
        assert [number for path in files_in(tmp_path) for number in sequence_in(path)] == list(range(400))

    def test_a_file_ends_after_its_time_and_when_the_clock_steps_back(self, tmp_path: Path) -> None:
        files = series_in(tmp_path, Limits(file_seconds=10.0))
        for k in (0, 299, 302, 0):  # 30 Hz
            files.write([measured(k)], 0.0)
        stopped(files)
        assert [sequence_in(path) for path in files_in(tmp_path)] == [[0, 299], [302], [0]]

    def test_the_total_never_exceeds_its_limit_and_the_oldest_go(self, tmp_path: Path) -> None:
        files = series_in(tmp_path, SMALL)
        for k in range(1500):
            files.write([measured(k)], 0.0)
            assert files.path is not None
            assert files.path.exists()
            assert sum(path.stat().st_size for path in files_in(tmp_path)) <= SMALL.total_bytes
        stopped(files)
        assert files.bytes == sum(path.stat().st_size for path in files_in(tmp_path))
        kept = [number for path in files_in(tmp_path) for number in sequence_in(path)]
        assert kept == list(range(kept[0], 1500))
        assert kept[0] > 0

    def test_recordings_of_before_count_and_go_first(self, tmp_path: Path) -> None:
        for run in range(3):
            files = series_in(tmp_path, SMALL)
            for k in range(150):
                files.write([measured(1000 * run + k)], 0.0)
            stopped(files)
        assert sum(path.stat().st_size for path in files_in(tmp_path)) <= SMALL.total_bytes
        kept = [number for path in files_in(tmp_path) for number in sequence_in(path)]
        assert kept == sorted(kept)
        assert 0 not in kept
        assert kept[-1] == 2149

    def test_files_of_the_user_and_of_other_devices_are_left_alone(self, tmp_path: Path) -> None:
        (tmp_path / "left").mkdir()
        mine = tmp_path / "left" / "the good run.mcap"
        mine.write_bytes(bytes(SMALL.total_bytes))
        files = series_in(tmp_path, SMALL)
        for k in range(600):
            files.write([measured(k)], 0.0)
        stopped(files)
        assert mine.stat().st_size == SMALL.total_bytes
        assert files.bytes <= SMALL.total_bytes

    def test_an_old_file_is_never_written_to(self, tmp_path: Path) -> None:
        first = series_in(tmp_path)
        first.write([measured(0)], 0.0)  # and is not ended
        old = files_in(tmp_path)[0]
        content = old.read_bytes()
        again = series_in(tmp_path)
        again.write([measured(1)], 0.0)
        stopped(again)
        assert old.read_bytes() == content
        assert [sequence_in(path) for path in files_in(tmp_path)] == [[0], [1]]
        stopped(first)

    def test_no_file_without_a_batch(self, tmp_path: Path) -> None:
        files = series_in(tmp_path)
        files.write([EventItem("connected", 0.0), StopItem()], 0.0)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        ("file_bytes", "total_bytes", "file_seconds"),
        [(1000, 10**9, 60.0), (10**6, 10**6, 60.0), (10**6, 10**9, 0.0), (10**6, 10**9, float("nan"))],
    )
    def test_limits_that_cannot_hold_are_refused(self, file_bytes: int, total_bytes: int, file_seconds: float) -> None:
        with pytest.raises(InvalidInput):
            Limits(file_bytes, file_seconds, total_bytes)

    @pytest.mark.parametrize("device", ["", ".", "..", "a/b"])
    def test_a_device_cannot_leave_its_folder(self, tmp_path: Path, device: str) -> None:
        with pytest.raises(InvalidInput):
            series_in(tmp_path, device=device)


def test_what_is_added_is_written_when_it_is_time_though_nothing_follows(tmp_path: Path) -> None:
    files = RotatingFiles(tmp_path, "left", Limits(), structlog.get_logger(), commit_every=2.0)
    assert files.write([measured(0)], 100.0).recorded == 1  # at once: whoever starts a recording sees the file
    assert files.write([measured(1)], 100.5).recorded == 0
    assert files.write([measured(2)], 101.9).recorded == 0
    assert sequence_in(files_in(tmp_path)[0]) == [0]
    assert files.write([], 102.0).recorded == 2
    assert sequence_in(files_in(tmp_path)[0]) == [0, 1, 2]
    assert files.write([measured(3), StopItem()], 102.1).recorded == 1


class Disk:
    """Stands in for `os.write`: takes `free` bytes, then refuses with `error`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free = 10**12
        self.error = errno.ENOSPC
        self._write = os.write
        monkeypatch.setattr("pretouch_sensor_gateway.recording.file.os.write", self)

    def __call__(self, descriptor: int, data: bytes) -> int:
        if not self.free:
            raise OSError(self.error, os.strerror(self.error))
        written = self._write(descriptor, data[: self.free])
        self.free -= written
        return written


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


class TestFullDisk:
    @pytest.mark.parametrize("error", [errno.ENOSPC, errno.EFBIG, errno.EDQUOT, errno.EIO, errno.EROFS])
    def test_it_pauses_says_why_and_goes_on(self, tmp_path: Path, disk: Disk, error: int) -> None:
        files = series_in(tmp_path)
        with structlog.testing.capture_logs() as logs:
            assert files.write([measured(0)], 0.0).recorded == 1
            disk.free, disk.error = 100, error
            counts = [files.write([measured(k)], 0.1 * k) for k in range(1, 100)]
            assert all((count.recorded, count.unrecorded) == (0, 1) for count in counts)
            assert os.strerror(error) in files.problem
            disk.free = 10**12
            assert files.write([measured(100)], RETRY_AFTER).unrecorded == 1  # 10 s after the first failure, not before
            assert files.write([measured(101)], RETRY_AFTER + 0.2).recorded == 1
            assert files.problem == ""
        stopped(files)
        assert [entry["event"] for entry in logs] == ["recording is paused", "recording goes on"]
        assert logs[1]["unrecorded"] == 100
        assert [sequence_in(path) for path in files_in(tmp_path)] == [[0], [101]]
        assert "100 frames were not recorded" in " ".join(log_in(files_in(tmp_path)[1]))

    def test_the_torn_record_is_cut_away_wherever_the_disk_is_full(self, tmp_path: Path, disk: Disk) -> None:
        for free in range(0, 800, 7):
            files = series_in(tmp_path / str(free))
            (tmp_path / str(free)).mkdir()
            files.write([measured(0)], 0.0)
            size = files.bytes
            disk.free = free
            written = files.write([measured(1)], 0.0)
            disk.free = 10**12
            path = files_in(tmp_path / str(free))[0]
            if written.recorded:
                stopped(files)
                assert sequence_in(path) == [0, 1]
            else:
                assert written.unrecorded == 1
                assert path.stat().st_size == files.bytes == size
                assert sequence_in(path) == [0]

    def test_it_is_tried_again_and_again_without_litter(self, tmp_path: Path, disk: Disk) -> None:
        files = series_in(tmp_path)
        disk.free = 0
        with structlog.testing.capture_logs() as logs:
            for k in range(100):
                assert files.write([measured(k)], k * RETRY_AFTER).unrecorded == 1
        assert len(logs) == 1
        assert files_in(tmp_path) == []

    def test_all_frames_count_when_a_file_ends_on_a_full_disk(self, tmp_path: Path, disk: Disk) -> None:
        files = series_in(tmp_path, Limits(file_bytes=64 * 1024))
        given = recorded = unrecorded = 0
        for k in range(600):
            disk.free = 20_000 if k % 40 < 30 else 3
            items: list[Item] = [measured(given), measured(given + 1, 3)]
            written = files.write(items, 3.0 * k)
            given += 4
            recorded += written.recorded
            unrecorded += written.unrecorded
            assert recorded + unrecorded == given
        disk.free = 10**12
        stopped(files)
        assert recorded > 0
        assert unrecorded > 0
        found = [number for path in files_in(tmp_path) for number in sequence_in(path)]
        assert found == sorted(set(found))
        assert len(found) == recorded

    def test_a_device_that_takes_nothing(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        opened = os.open
        monkeypatch.setattr(
            "pretouch_sensor_gateway.recording.file.os.open", lambda *_: opened("/dev/full", os.O_WRONLY)
        )
        files = series_in(tmp_path)
        assert files.write([measured(0)], 0.0).unrecorded == 1
        assert os.strerror(errno.ENOSPC) in files.problem


class TestFolder:
    def test_its_removal_pauses_and_it_is_made_again(self, tmp_path: Path) -> None:
        files = series_in(tmp_path)
        files.write([measured(0)], 0.0)
        shutil.rmtree(tmp_path / "left")
        assert files.write([measured(1)], 0.0).unrecorded == 1
        assert "deleted" in files.problem
        assert files.write([measured(2)], RETRY_AFTER).recorded == 1
        stopped(files)
        assert [sequence_in(path) for path in files_in(tmp_path)] == [[2]]

    def test_a_missing_root_is_not_made_for_it_may_be_a_disk_that_is_not_mounted(self, tmp_path: Path) -> None:
        files = series_in(tmp_path / "disk")
        assert files.write([measured(0)], 0.0).unrecorded == 1
        assert os.strerror(errno.ENOENT) in files.problem
        (tmp_path / "disk").mkdir()
        assert files.write([measured(1)], RETRY_AFTER).recorded == 1
        stopped(files)

    def test_something_in_its_place(self, tmp_path: Path) -> None:
        (tmp_path / "left").write_text("a file")
        files = series_in(tmp_path)
        assert files.write([measured(0)], 0.0).unrecorded == 1
        assert "left" in files.problem

    def test_a_defect_costs_the_batch_and_is_logged(self, tmp_path: Path) -> None:
        files = series_in(tmp_path)
        with structlog.testing.capture_logs() as logs:
            broken = BatchItem(None, 2)  # type: ignore[arg-type]
            written = files.write([measured(0), broken], 0.0)
            assert (written.recorded, written.unrecorded) == (0, 3)
            assert files.write([measured(1)], RETRY_AFTER).recorded == 1
        assert logs[0]["exc_info"] is True
        stopped(files)


def is_complete(path: Path) -> bool:
    reader = RecordingReader(path)
    list(reader)
    return reader.complete and reader.torn_bytes == 0
