"""A session's recording: complete in every state, bounded, and true to the session for viewers of other makers."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.loop_fakes import FormulaRegistrar, RandomDetector, answer, asked, misses, opened
from helpers.records import a_record, after_a_scan
from helpers.session_recordings import points_of, record_messages, recorded_session
from helpers.sources import ROOT
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import make_reader
from pretouch_orchestrator.recording import foxglove
from pretouch_orchestrator.recording.file import write_recording
from pretouch_orchestrator.sessions.loop import Loop
from pretouch_orchestrator.store.protocol import NewEvent

from pretouch.camera import Camera, DepthImage
from pretouch.geometry import Pose, rotation_from_quaternion
from pretouch.scene import Scene
from pretouch.session import State
from pretouch.tof import MAX_SAMPLES, Scan
from pretouch.wire.common import estimate_from_proto, scan_from_proto, scene_from_proto
from pretouch.wire.json import request_to_json
from pretouch.wire.session import request_from_proto, session_from_proto

ALWAYS = {
    "/pretouch/session",
    "/tf",
    "/camera/calibration",
    "/camera/depth",
    "/camera/regions",
    "/camera/surroundings",
    "/object/before",
    "/object/after",
    "/object/pose",
    "/scene",
    "/events",
}
SCANNED = {"/scan/hits", "/scan/path", "/pretouch/scans"}
numbers = arrays(np.float64, 6, elements=st.floats(-1, 1))


def test_the_clouds_and_beams_are_those_of_the_session() -> None:
    record, events = recorded_session()
    found = record_messages(record, events)
    assert set(found) == ALWAYS | SCANNED
    hits = np.concatenate([points_of(cloud) for cloud in found["/scan/hits"]])
    np.testing.assert_allclose(hits, np.concatenate([scan.points() for scan in record.measured]), atol=1e-6)
    before, after = points_of(found["/object/before"][0]), [points_of(cloud) for cloud in found["/object/after"]]
    np.testing.assert_allclose(after[0], before, atol=1e-6)
    np.testing.assert_allclose(after[-1], record.estimate.base_T_correction.apply(before), atol=1e-6)
    assert len(after) == len(record.scans) + 1
    assert {cloud.frame_id for cloud in (*found["/scan/hits"], *found["/object/after"])} == {"base"}


def test_the_images_are_those_of_the_camera() -> None:
    record, events = recorded_session(scans=1)
    found = record_messages(record, events)
    (depth,), (calibration,) = found["/camera/depth"], found["/camera/calibration"]
    height, width = record.scene.depth.metres.shape
    assert (depth.height, depth.width, depth.step, depth.encoding) == (height, width, 2 * width, "16UC1")
    pixels = np.frombuffer(depth.data, "<u2").reshape(height, width)
    np.testing.assert_allclose(pixels / 1000, record.scene.depth.metres, atol=0.00051)
    assert (calibration.width, calibration.height) == (width, height)
    assert list(calibration.K)[:3] == [record.scene.camera.fx, 0, record.scene.camera.cx]
    (regions,) = found["/camera/regions"]
    assert [text.text for text in regions.texts] == [str(k + 1) for k in range(len(record.regions))]


def test_the_pose_is_the_corrected_object_in_base() -> None:
    base_T_object = Pose.from_rotation_vector([0.1, 0.2, 0.3], [0.45, 0.01, 0.02])
    record, events = recorded_session(base_T_object=base_T_object)
    last = record_messages(record, events)["/object/pose"][-1]
    expected = record.estimate.base_T_correction @ base_T_object
    p, q = last.pose.position, last.pose.orientation
    assert Pose.from_quaternion([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]).is_close(expected)
    covariance = np.reshape(last.pose_covariance, (6, 6))
    np.testing.assert_allclose(covariance[3:, 3:], record.estimate.covariance[:3, :3])
    assert covariance[0, 0] > record.estimate.covariance[3, 3], "the object's origin is far from its centroid"


@given(numbers, numbers)
def test_the_covariance_is_of_the_origins_translation_then_the_rotation(error: Any, place: Any) -> None:
    estimate = replace(a_record().estimate, covariance=np.outer(error, error))
    origin = estimate.base_T_correction.apply(estimate.centroid) + place[:3]
    turn, shift = error[:3], error[3:]
    expected = np.concatenate([shift + np.cross(turn, place[:3]), turn])
    np.testing.assert_allclose(foxglove.covariance_at(estimate, origin), np.outer(expected, expected), atol=1e-12)


@given(numbers.filter(lambda v: np.linalg.norm(v[3:]) > 1e-3))
def test_a_beams_frame_has_z_along_it(beam: Any) -> None:
    (pose,) = foxglove.beam_poses(beam[None, :3], beam[None, 3:])
    q = pose.orientation
    turned = rotation_from_quaternion([q.x, q.y, q.z, q.w])
    np.testing.assert_allclose(turned.T @ turned, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(turned[:, 2], beam[3:] / np.linalg.norm(beam[3:]), atol=1e-5)


def test_misses_are_apart_at_the_end_of_the_range() -> None:
    loop = Loop(RandomDetector(), FormulaRegistrar())
    record = answer(loop, opened(loop, asked()), misses(9))
    found = record_messages(record, [])
    assert "/scan/hits" not in found
    points = np.concatenate([points_of(cloud) for cloud in found["/scan/misses"]])
    reach = record.measured[0].origins + record.request.sensor.range_max * record.measured[0].directions
    np.testing.assert_allclose(points, reach, atol=1e-6)


@pytest.mark.parametrize("state", list(State))
def test_every_state_has_a_recording_without_a_scan_too(state: State) -> None:
    for record in (a_record(), after_a_scan(a_record())):
        found = record_messages(replace(record, state=state), [])
        assert set(found) >= ALWAYS
        assert len(found["/object/after"]) == len(record.scans) + 1
        if state.ended:
            assert found["/events"][-1].message.startswith(state.value)


def test_what_a_replay_needs_comes_back_to_the_bit() -> None:
    record, events = recorded_session()
    record = replace(record, estimate=replace(record.estimate, engine="posterior"))
    found = record_messages(record, events)
    (told,) = found["/pretouch/session"]
    assert scene_from_proto(told.scene).digest == record.scene.digest
    assert (told.u0, told.v0) == record.origin
    assert told.settings.engine == "posterior"
    assert told.created == record.created
    assert set(told.versions) == {"pretouch", "python", "numpy", "machine"}
    assert request_to_json(request_from_proto(told.request)[0]) == request_to_json(record.request)
    assert session_from_proto(told.session).scans == record.scans
    for scan, entry in zip(record.measured, found["/pretouch/scans"], strict=True):
        assert scan_from_proto(entry.scan).ranges.tobytes() == scan.ranges.tobytes()
    errors = [estimate_from_proto(entry.estimate).expected_error for entry in found["/pretouch/scans"]]
    assert errors == [scan.expected_error for scan in record.scans]


def test_its_clock_is_robot_time_from_the_sessions_creation() -> None:
    record, events = recorded_session()
    record = replace(record, created=1.7e9)
    times = [
        message.log_time for _, _, message in make_reader(io.BytesIO(write_recording(record, events))).iter_messages()
    ]
    assert times == sorted(times)
    assert times[0] == 1_700_000_000 * 10**9
    assert (times[-1] - times[0]) / 1e9 == pytest.approx(record.budget_used.seconds)


def test_the_same_session_is_recorded_the_same() -> None:
    record, events = recorded_session()
    assert write_recording(record, events) == write_recording(record, events)


@pytest.mark.parametrize(("scans", "samples"), [(20, MAX_SAMPLES), (1000, 40)])
def test_the_largest_sessions_stay_below_forty_megabytes(scans: int, samples: int) -> None:
    rng = np.random.default_rng(0)
    record, events = recorded_session(scans=1)
    size = (1000, 1000)
    scene = Scene(
        DepthImage(rng.uniform(0.4, 0.9, size).astype(np.float32)),
        Camera(record.request.camera.fx, record.request.camera.fy, 500.0, 500.0),
        record.scene.base_T_camera,
        rng.random(size) < 0.9,
        record.scene.table,
    )
    directions = rng.normal(size=(samples, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = np.where(rng.random(samples) < 0.2, np.nan, rng.uniform(0.01, 0.1, samples))
    beams = Scan(rng.uniform(-1, 1, (samples, 3)), directions, ranges)
    summary = replace(record.scans[0], samples=samples, duration=60.0)
    record = replace(record, scene=scene, scans=(summary,) * scans, measured=(beams,) * scans)
    estimate = next(event for event in events if event.type == "estimate")
    assert len(write_recording(record, [*[NewEvent("scan", {}), estimate] * scans])) < 40_000_000


def test_foxgloves_layout_shows_topics_that_there_are() -> None:
    layout = json.loads((ROOT / "deploy/foxglove/session.json").read_text())
    panels = layout["configById"]
    assert set(panels) == set(_leaves(layout["layout"]))
    record, events = recorded_session(scans=1)
    there = {*record_messages(record, events), "/scan/misses", "/plan/path"}
    shown = set(panels["3D!before-and-after"]["topics"])
    image = panels["Image!depth"]["imageMode"]
    shown |= {image["imageTopic"], image["calibrationTopic"], *image["annotations"]}
    shown |= {panels["RosOut!events"]["topicToRender"]}
    assert shown <= there
    (scan, *_) = record_messages(record, events)["/pretouch/scans"]
    for path in panels["Plot!error"]["paths"]:
        topic, _, member = path["value"].partition(".")
        assert topic == "/pretouch/scans"
        assert getattr(scan.estimate, member.removeprefix("estimate.")) > 0


def _leaves(layout: Any) -> list[str]:
    if isinstance(layout, str):
        return [layout]
    return [*_leaves(layout["first"]), *_leaves(layout["second"])]


def rerun(*arguments: str) -> str:
    """What Rerun's own tool says."""
    pytest.importorskip("rerun", reason="pip install 'pretouch[live]'")
    command = shutil.which("rerun", path=str(Path(sys.executable).parent))
    assert command is not None
    done = subprocess.run([command, *arguments], capture_output=True, text=True, check=True, timeout=250)
    return done.stdout + done.stderr


def test_rerun_converts_a_recording(tmp_path: Path) -> None:
    record, events = recorded_session()
    path = tmp_path / "session.mcap"
    path.write_bytes(write_recording(record, events))
    assert "error" not in rerun("mcap", "check", str(path)).lower()
    rerun("mcap", "convert", str(path), "-o", str(tmp_path / "session.rrd"))
    printed = rerun("rrd", "print", str(tmp_path / "session.rrd"))
    understood = {
        "/object/before": "Points3D:positions",
        "/object/after": "Points3D:positions",
        "/scan/hits": "Points3D:positions",
        "/camera/depth": "Image:buffer",
        "/camera/calibration": "Pinhole:image_from_camera",
        "/tf": "Transform3D:translation",
        "/events": "TextLog:text",
    }
    for topic, component in understood.items():
        assert any(f"- {topic} -" in line and component in line for line in printed.splitlines()), topic


def test_reruns_blueprint_is_one_that_it_reads_and_names_topics_that_there_are() -> None:
    printed = rerun("rrd", "print", str(ROOT / "deploy/rerun/session.rbl"))
    record, events = recorded_session(scans=1)
    overridden = {
        line.partition("/ViewContents/overrides")[2].partition("/visualizers")[0].partition(" ")[0]
        for line in printed.splitlines()
        if "/ViewContents/overrides/" in line
    }
    assert overridden
    assert overridden <= {*record_messages(record, events), "/scan/misses"}
