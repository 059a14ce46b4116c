"""Absurd input is noticed: refused where it cannot be, else a warning in the session; the same over REST and gRPC."""

from __future__ import annotations

import dataclasses
from collections.abc import AsyncIterator, Callable
from typing import Any

import numpy as np
import pytest
from helpers.box_session import DEPTH, DEPTH_SCALE, MASK, ROOMY, VIEW, measured, request
from helpers.client_kinds import opened
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from numpy.typing import NDArray

from pretouch.camera import Camera
from pretouch.client import RestClient
from pretouch.errors import InvalidInput
from pretouch.geometry import Plane, Pose
from pretouch.session import Budget, GatewaySpan, Points, SampleChunk, Session, SessionRequest, Tolerance
from pretouch.tof import RangeSamples

C, T = VIEW.camera, VIEW.base_T_camera
METRES = (DEPTH * DEPTH_SCALE).astype(np.float32)
GOOD = request(budget=Budget(**ROOMY), width=320, height=240)


@dataclasses.dataclass(frozen=True)
class Absurd:
    """What a client gets wrong, and words of what it is told when it creates a session: refused if `code` is empty."""

    words: tuple[str, ...]
    code: str = ""
    request: SessionRequest = GOOD
    depth: NDArray[Any] = dataclasses.field(default_factory=lambda: DEPTH)
    mask: NDArray[Any] | None = dataclasses.field(default_factory=lambda: MASK)


def posed(pose: Pose) -> SessionRequest:
    return dataclasses.replace(GOOD, base_T_camera=pose)


def seen_by(*intrinsics: float, **changes: Any) -> SessionRequest:
    return dataclasses.replace(GOOD, camera=Camera(*intrinsics), **changes)


def pointed(at: Any) -> SessionRequest:
    return dataclasses.replace(GOOD, tolerance=Tolerance(at=np.asarray(at, dtype=np.float64)))


def scaled(scale: float | None) -> SessionRequest:
    return dataclasses.replace(GOOD, depth_scale=scale)


ABSURD = {
    "pose in millimetres": Absurd(
        ("millimetres",), "pose-millimetres", posed(Pose.of(T.rotation, 1000 * T.translation))
    ),
    "pose inverted": Absurd(("inverted", "read so, the table is 0 degrees"), "pose-inverted", posed(T.inverse())),
    "OpenGL axes": Absurd(
        ("OpenGL", "180 degrees"), "pose-opengl", posed(T @ Pose.of(np.diag([1, -1, -1]), [0, 0, 0]))
    ),
    "pose of the link frame": Absurd(
        ("link frame",), "pose-link-frame", posed(T @ Pose.of(np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0, 0, 0]))
    ),
    "quaternion wxyz": Absurd(
        ("w, x, y, z",), "pose-wxyz", posed(Pose.from_quaternion(T.translation, np.roll(T.quaternion, 1)))
    ),
    "identity": Absurd(("identity",), "pose-identity", posed(Pose.identity())),
    "metres said to be millimetres": Absurd(("0.001", "It would be", "with 1"), "", scaled(0.001), METRES),
    "tenths of a millimetre said to be millimetres": Absurd(
        ("is 7.74 m from", "0.77 m with 0.0001"), "depth-scale", scaled(None)
    ),
    "fifths of a millimetre said to be millimetres": Absurd(
        ("is 3.87 m from", "0.77 m with 0.0002"), "depth-scale", scaled(None), np.round(METRES * 5000).astype(np.uint16)
    ),
    "bytes swapped": Absurd(("swapped", "median depth"), "", GOOD, DEPTH.byteswap()),
    "intrinsics of twice the resolution": Absurd(
        ("outside the image", "640 x 480"), "", seen_by(2 * C.fx, 2 * C.fy, 2 * C.cx + 0.5, 2 * C.cy + 0.5)
    ),
    "intrinsics of half the resolution": Absurd(
        ("160 x 120", "multiply all four by 2"), "principal-point", seen_by(C.fx / 2, C.fy / 2, C.cx / 2, C.cy / 2)
    ),
    "cx and cy swapped": Absurd(("look swapped",), "principal-point", seen_by(C.fx, C.fy, C.cy, C.cx)),
    "another resolution said": Absurd(
        ("640 x 480", "by 0.5"), "intrinsics-resolution", dataclasses.replace(GOOD, width=640, height=480)
    ),
    "focal lengths in millimetres": Absurd(("field of view",), "focal-length", seen_by(35.0, 35.0, C.cx, C.cy)),
    "table tilted": Absurd(
        ("20 degrees",), "table-tilted", posed(Pose.from_rotation_vector([0.35, 0, 0], [0, 0, 0]) @ T)
    ),
    "table given 30 cm too low": Absurd(
        ("0.30 m from the one that was given",),
        "table-mismatch",
        dataclasses.replace(GOOD, table=Plane(np.array([0, 0, 1.0]), -0.3)),
    ),
    "table given above the camera": Absurd(
        ("1.41 m below",), "", dataclasses.replace(GOOD, table=Plane(np.array([0, 0, 1.0]), 2.0))
    ),
    "object's pose of another object": Absurd(
        ("1.02 m from the object",),
        "object-pose-far",
        dataclasses.replace(GOOD, base_T_object=Pose.of(np.eye(3), [1, 0, 0])),
    ),
    "tolerance points in millimetres": Absurd(
        ("m from the object", "in millimetres"), "", pointed([[0, 0, 40], [10, 20, 50]])
    ),
    "tolerance points in the camera's frame": Absurd(
        ("0.7", "in the camera's frame"), "tolerance-points-far", pointed(T.inverse().apply(np.array([[0, 0, 0.025]])))
    ),
    "mask inverted": Absurd(("inverted",), "", GOOD, DEPTH, ~MASK),
    "mask of the table": Absurd(("Nothing in the mask rises",), "", GOOD, DEPTH, np.roll(MASK, 100, axis=1)),
    "mask of everything": Absurd(("100%",), "", GOOD, DEPTH, np.ones_like(MASK)),
}


@pytest.fixture(params=["rest-async", "grpc-async"])
async def client(request: pytest.FixtureRequest, orchestrator: Orchestrator) -> AsyncIterator[Any]:
    async with opened(request.param, orchestrator.rest_url, orchestrator.address) as opened_client:
        yield opened_client


@pytest.mark.parametrize("name", ABSURD)
async def test_absurd_input_is_noticed_when_a_session_is_created(name: str, client: Any) -> None:
    absurd = ABSURD[name]
    if not absurd.code:
        with pytest.raises(InvalidInput) as caught:
            await client.create_session(absurd.request, absurd.depth, absurd.mask)
        said = caught.value.detail
        assert caught.value.remedy
    else:
        session = await client.create_session(absurd.request, absurd.depth, absurd.mask)
        (said,) = (each.detail + each.remedy for each in session.warnings if each.code == absurd.code)
        assert all(warning.remedy for warning in session.warnings)
        assert (await client.session(session.id)).warnings == session.warnings
    for word in absurd.words:
        assert word in said


async def test_good_input_is_no_warning_and_the_session_shows_its_table(client: Any) -> None:
    for table in (None, Plane(np.array([0.0, 0.0, 1.0]), 0.0005)):
        session = await client.create_session(dataclasses.replace(GOOD, table=table), DEPTH, MASK)
        assert session.warnings == ()
        np.testing.assert_allclose(session.table.normal, [0, 0, 1], atol=2e-3)
        assert session.table.offset == pytest.approx(0.0005 if table else 0.0, abs=3e-4)
        assert session.next_scan is not None
        after = await client.submit(session.id, session.next_scan.scan_id, measured(session.next_scan))
        assert after.warnings == ()
        assert after.table.offset == session.table.offset


def in_millimetres(samples: RangeSamples) -> RangeSamples:
    return dataclasses.replace(samples, range=1000 * samples.range)


def moved(samples: RangeSamples, **columns: Any) -> RangeSamples:
    """The samples with their tips' `factor`, `shift` or `turn` changed."""
    poses = samples.base_T_tip.copy()
    poses[:, :3, 3] = columns.get("factor", 1.0) * poses[:, :3, 3] + columns.get("shift", 0.0)
    poses[:, :3, :3] = poses[:, :3, :3] @ columns.get("turn", np.eye(3))
    return dataclasses.replace(samples, base_T_tip=poses)


FLIPPED, ASLANT = np.diag([1.0, -1.0, -1.0]), Pose.from_rotation_vector([0.6, 0, 0], [0, 0, 0]).rotation
BAD_SAMPLES: dict[str, tuple[str, Callable[[RangeSamples], RangeSamples]]] = {
    "ranges in millimetres": ("millimetres", in_millimetres),
    "tip poses in millimetres": ("In millimetres", lambda samples: moved(samples, factor=1000.0)),
    "tip poses of another base": ("m from the planned path", lambda samples: moved(samples, shift=3.0)),
    "z backwards": ("points away", lambda samples: moved(samples, turn=FLIPPED)),
    "times in milliseconds": ("milliseconds", lambda samples: dataclasses.replace(samples, t=1000 * samples.t)),
    "times in kiloseconds": ("m/s", lambda samples: dataclasses.replace(samples, t=samples.t / 1000)),
}
ODD_SAMPLES: dict[str, tuple[str, Callable[[RangeSamples], RangeSamples]]] = {
    "tip of the flange": ("base-t-tip-off-path", lambda samples: moved(samples, shift=np.array([0, 0, 0.15]))),
    "tip aslant": ("tip-tilted", lambda samples: moved(samples, turn=ASLANT)),
}


@pytest.fixture(scope="module")
def waiting(orchestrator: Orchestrator) -> Session:
    """A session that waits for its first scan; nothing that is refused moves it on."""
    with RestClient(orchestrator.rest_url) as client:
        return client.create_session(GOOD, DEPTH, MASK)


@pytest.mark.parametrize("name", BAD_SAMPLES)
async def test_samples_that_cannot_be_are_refused_told_or_submitted(name: str, waiting: Session, client: Any) -> None:
    word, spoil = BAD_SAMPLES[name]
    plan = waiting.next_scan
    assert plan is not None
    spoilt = spoil(measured(plan))
    with pytest.raises(InvalidInput, match=word):
        await client.submit(waiting.id, plan.scan_id, spoilt)
    with pytest.raises(InvalidInput, match=word):
        await client.tell(waiting.id, plan.scan_id, SampleChunk(0, spoilt))
    after = await client.session(waiting.id)
    assert after.next_scan.scan_id == plan.scan_id
    assert after.budget_used.scans == 0


@pytest.mark.parametrize("name", ODD_SAMPLES)
async def test_samples_that_are_odd_are_used_with_a_warning(name: str, client: Any) -> None:
    code, spoil = ODD_SAMPLES[name]
    session = await client.create_session(GOOD, DEPTH, MASK)
    after = await client.submit(session.id, session.next_scan.scan_id, spoil(measured(session.next_scan)))
    (detail,) = (warning.detail for warning in after.warnings if warning.code == code)
    assert detail.startswith("In scan-1: The tip")
    assert after.budget_used.scans == 1


async def test_points_in_millimetres_are_refused(waiting: Session, client: Any) -> None:
    scan = measured(waiting.next_scan).beams(GOOD.sensor)
    with pytest.raises(InvalidInput, match="In millimetres"):
        await client.submit(waiting.id, waiting.next_scan.scan_id, Points(1000 * scan.points()))


async def test_samples_of_the_gateway_are_checked_too(
    waiting: Session, client: Any, fakes: FakeUpstream, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = waiting.next_scan
    assert plan is not None
    span = GatewaySpan("finger", 1.0, 2.0)
    monkeypatch.setattr(fakes, "samples", in_millimetres(measured(plan)))
    with pytest.raises(InvalidInput, match="millimetres"):
        await client.submit(waiting.id, plan.scan_id, span)
    with pytest.raises(InvalidInput, match="millimetres"):
        await client.tell(waiting.id, plan.scan_id, span)
