"""A recording is what MCAP's own tools and Foxglove expect."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.gateway_recordings import MODULES, T0, files_in, made_batch, made_configuration, measured, series_in
from mcap.reader import make_reader
from mcap.records import DataEnd
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory
from pretouch_sensor_gateway.recording.queue_items import BatchItem, ConfigurationItem, EventItem, StopItem

from pretouch.geometry import Pose, rotation_from_quaternion
from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_to_proto, pose_from_proto

CLOUDS = [0, 3, 6, 9, 12, 15, 18, 24]
"""The last frame of each cloud in the recording: one in 0.1 s, and one at the end."""
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("module", "u1"), ("status", "u1"), ("flags", "u1")])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("foxglove")
    files = series_in(root)
    files.write([ConfigurationItem(made_configuration(), T0), EventItem("connected", T0)], 0.0)
    files.write([measured(k) for k in range(20)], 0.0)
    files.write([measured(20, 5), EventItem("lost", T0 + 1), StopItem()], 0.0)
    return files_in(root)[0]


def decoded(path: Path) -> list[tuple[str, int, Any]]:
    """Topic, time and message, in the order of time."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.log_time, value) for _, channel, message, value in reader.iter_decoded_messages()
        ]


def of(path: Path, topic: str) -> list[Any]:
    return [message for found, _, message in decoded(path) if found == topic]


def test_the_summary_tells_channels_schemas_and_counts(path: Path) -> None:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert {
        channel.topic: (
            summary.schemas[channel.schema_id].name,
            summary.schemas[channel.schema_id].encoding,
            channel.message_encoding,
            summary.statistics.channel_message_counts[channel.id],
        )
        for channel in summary.channels.values()
    } == {
        "/left/ranges": ("pretouch.v1.RangeBatch", "protobuf", "protobuf", 21),
        "/left/points": ("foxglove.PointCloud", "protobuf", "protobuf", len(CLOUDS)),
        "/left/configuration": ("pretouch.v1.DeviceConfiguration", "protobuf", "protobuf", 1),
        "/left/tf": ("foxglove.FrameTransforms", "protobuf", "protobuf", 1),
        "/left/log": ("foxglove.Log", "protobuf", "protobuf", 3),
    }
    assert summary.statistics.message_end_time == round((T0 + 1) * 1e9)


def test_every_chunk_is_compressed_and_indexed(path: Path) -> None:
    """Readers that seek, Foxglove's and Rerun's, see only what the indexes name."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == 2  # two writes held batches
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    with_messages = {channel for chunk in summary.chunk_indexes for channel in chunk.message_index_offsets}
    assert with_messages == set(summary.channels)
    assert sum(chunk.compressed_size for chunk in summary.chunk_indexes) < 0.5 * sum(
        chunk.uncompressed_size for chunk in summary.chunk_indexes
    )


def test_reruns_converter_reads_every_message(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="pip install 'pretouch[live]'")
    rerun = shutil.which("rerun", path=str(Path(sys.executable).parent))
    assert rerun is not None
    converted = tmp_path / "recording.rrd"
    subprocess.run([rerun, "mcap", "convert", path, "-o", converted], check=True, capture_output=True)
    printed = subprocess.run([rerun, "rrd", "print", "-v", converted], check=True, capture_output=True, text=True)
    rows: Counter[str] = Counter()
    for count, columns in re.findall(r"with (\d+) rows .* data columns: \[(.*)\]", printed.stdout):
        rows.update({column.split("@")[1]: int(count) for column in columns.split()})
    assert rows["pretouch.v1.RangeBatch:message"] == 21
    assert rows["Points3D:positions"] == len(CLOUDS)
    assert rows["pretouch.v1.DeviceConfiguration:message"] == 1
    assert rows["Transform3D:translation"] == MODULES
    assert rows["TextLog:text"] == 3


def test_every_checksum_is_right(path: Path) -> None:
    with path.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    kinds = Counter(type(record).__name__ for record in records)
    (data_end,) = (record for record in records if isinstance(record, DataEnd))
    assert data_end.data_section_crc != 0  # 0 would mean: not checked
    assert kinds["Message"] == 21 + len(CLOUDS) + 1 + 1 + 3
    assert kinds["Footer"] == 1


def test_a_program_that_knows_nothing_of_pretouch_reads_the_ranges(path: Path) -> None:
    times = [t for batch in of(path, "/left/ranges") for t in np.frombuffer(batch.t.data, "<f8")]
    np.testing.assert_array_equal(times, T0 + np.arange(25) / 30.0)


def test_the_points_are_where_the_modules_beams_end(path: Path) -> None:
    clouds = of(path, "/left/points")
    modules = [pose_from_proto(pose, "") for pose in made_configuration().tip_t_module]
    expected = [pose.apply([0.0, 0.0, 0.01 * (k + 1)]) for k, pose in enumerate(modules)][:-1]  # the last one missed
    for cloud, frames in zip(clouds, np.diff([-1, *CLOUDS]), strict=True):
        points = points_of(cloud)
        np.testing.assert_allclose(np.stack([points["x"], points["y"], points["z"]], 1), expected * frames, atol=1e-7)
        np.testing.assert_array_equal(points["module"], list(range(MODULES - 1)) * frames)
        assert cloud.frame_id == "left/tip"
        assert cloud.pose.orientation.w == 1.0


def test_clouds_have_the_time_of_their_last_frame(path: Path) -> None:
    found = [(time, message) for topic, time, message in decoded(path) if topic == "/left/points"]
    assert [time for time, _ in found] == [round((T0 + k / 30.0) * 1e9) for k in CLOUDS]
    assert all(cloud.timestamp.ToNanoseconds() == time for time, cloud in found)


def test_the_transforms_place_each_module(path: Path) -> None:
    (message,) = of(path, "/left/tf")
    transforms = message.transforms
    assert [transform.child_frame_id for transform in transforms] == [f"left/module_{k}" for k in range(MODULES)]
    for transform, pose in zip(transforms, made_configuration().tip_t_module, strict=True):
        shift, turn = transform.translation, transform.rotation
        found = Pose.of(rotation_from_quaternion([turn.x, turn.y, turn.z, turn.w]), [shift.x, shift.y, shift.z])
        assert transform.parent_frame_id == "left/tip"
        assert found.is_close(pose_from_proto(pose, ""))


def test_the_log_tells_what_happened_even_before_the_file_began(path: Path) -> None:
    assert sorted(log.message for log in of(path, "/left/log")) == [
        "connected",
        "lost",
        "recording started",
    ]


def test_doubtful_ranges_are_drawn_with_their_marks_and_misses_clear_the_picture(tmp_path: Path) -> None:
    doubtful, missed = made_batch(0), made_batch(1)
    doubtful.status.data = bytes([0, 11, 0, 0, 0, 7])
    doubtful.flags.data = bytes([1, 0, 2, 0, 0, 0])
    missed.range.CopyFrom(array_to_proto(np.full((1, MODULES), np.nan), "f8"))
    first, second = (points_of(cloud) for cloud in clouds_of(tmp_path, [doubtful, missed]))
    assert first["status"].tolist() == [0, 11, 0, 0, 0]
    assert first["flags"].tolist() == [1, 0, 2, 0, 0]
    assert len(second) == 0


def test_a_new_configuration_is_recorded_and_drawn_by_from_then_on(tmp_path: Path) -> None:
    files = series_in(tmp_path)
    files.write([measured(0), ConfigurationItem(made_configuration(), T0 + 1), measured(60), StopItem()], 0.0)
    (path,) = files_in(tmp_path)
    assert [len(message.tip_t_module) for message in of(path, "/left/configuration")] == [0, MODULES]
    # Without a configuration there is one module at the tip: what the others saw has no known place.
    assert [len(points_of(cloud)) for cloud in of(path, "/left/points")] == [1, MODULES - 1]


def test_each_file_starts_with_the_configuration(tmp_path: Path) -> None:
    files = series_in(tmp_path)
    files.write([ConfigurationItem(made_configuration(), T0), measured(0), StopItem()], 0.0)
    files.write([measured(1), StopItem()], 0.0)
    for path in files_in(tmp_path):
        (configuration,) = of(path, "/left/configuration")
        assert configuration.SerializeToString() == made_configuration().SerializeToString()
        (tf,) = of(path, "/left/tf")
        assert len(tf.transforms) == MODULES


def clouds_of(root: Path, batches: list[pb.RangeBatch]) -> list[Any]:
    files = series_in(root)
    files.write(
        [ConfigurationItem(made_configuration(), T0), *(BatchItem(batch, 1) for batch in batches), StopItem()], 0.0
    )
    return of(files_in(root)[0], "/left/points")


def points_of(cloud: Any) -> np.ndarray:
    assert cloud.point_stride == POINT.itemsize
    names = [(field.name, field.offset) for field in cloud.fields]
    assert names == [(name, POINT.fields[name][1]) for name in POINT.names or ()]
    return np.frombuffer(cloud.data, POINT)
