"""The finger touches nothing: it is counted over small samples of what the planner offers; `experiments.contacts` over
large ones."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from pretouch_orchestrator.perception.preparation import prepare_scene
from pretouch_orchestrator.planning.lines import trace_lines
from pretouch_orchestrator.planning.path import PathPlanner
from pretouch_simulation.clutter import place_neighbours
from pretouch_simulation.contact import measure_clearance
from pretouch_simulation.finger import FingerModel, realise
from pretouch_simulation.objects import box, mug
from pretouch_simulation.protocol import PLACE, Case, case_of
from pretouch_simulation.scanning import fly_guarded
from pretouch_simulation.world import Body, World

from pretouch.client import Reflex
from pretouch.estimate import from_prior
from pretouch.geometry import Array, Plane, Pose
from pretouch.prior import Prior
from pretouch.session import ScanSettings, SessionRequest
from pretouch.trajectory import Trajectory

DOWN = np.diag([1.0, -1.0, -1.0])
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
LOW, TALL = box(0.08, 0.06, 0.03), box(0.05, 0.04, 0.16)


def tips(*places: tuple[float, float, float]) -> Array:
    return np.stack([Pose.of(DOWN, place).matrix for place in places])


@pytest.mark.parametrize(
    ("poses", "clearance"),
    [
        (tips((0.2, 0.0, 0.07)), 0.07),  # beside
        (tips((0.0, 0.0, 0.07)), 0.04),  # above
        (tips((0.0, 0.0, 0.02)), -0.01),  # within
        (tips((0.0495, 0.0, 0.02)), -0.01),  # the rim within
        (tips((0.0505, 0.0, 0.02)), 0.02),
        (tips((-0.2, 0.0, 0.04), (0.2, 0.0, 0.04)), 0.01),  # between two poses
    ],
)
def test_the_clearance_is_that_of_the_whole_end_along_the_beam(poses: Array, clearance: float) -> None:
    world = World([Body(LOW, Pose.identity())], TABLE)
    assert measure_clearance(world, poses) == pytest.approx(clearance, abs=1e-6)


def test_what_hangs_over_the_tip_is_in_the_finger() -> None:
    bridge = World([Body(LOW, Pose.of(np.eye(3), [0.0, 0.0, 0.2]))], TABLE)
    assert measure_clearance(bridge, tips((0.0, 0.0, 0.1))) == pytest.approx(-0.13)


def planner_of(case: Case, guarded: bool) -> PathPlanner:
    """Before the first scan."""
    request = SessionRequest(case.camera, case.base_T_camera, depth_scale=1.0)
    scene, _, _ = prepare_scene(request, case.depth, case.mask)
    return PathPlanner(scene, from_prior(request.prior or Prior(), scene.cloud), ScanSettings(guarded=guarded))


def clearance_of(case: Case, path: Trajectory, guarded: bool, seed: int) -> float:
    """m; a guarded path is flown by the finger models in turn."""
    if not guarded:
        return measure_clearance(case.world, path.base_T_tip)
    rng = np.random.default_rng(seed)
    finger = realise([*FingerModel][seed % len(FingerModel)], rng)
    descent, samples = fly_guarded(case.world, path, finger.sensor, finger, rng, Reflex())
    return measure_clearance(case.world, np.concatenate([descent, samples.base_T_tip]))


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize("view", [0, 1])
def test_no_path_touches_anything_in_clutter(view: int, guarded: bool) -> None:
    rng = np.random.default_rng(view)
    things = [[mesh] for mesh in (TALL, mug(), box(0.03, 0.12, 0.05), box(0.06, 0.06, 0.22), LOW)]
    case = case_of("low", LOW, view, rng, surround=partial(place_neighbours, things, rng))
    planner = planner_of(case, guarded)
    paths = [planner.follow_line(line) for line in trace_lines(planner.surface)[::2]]
    assert min(clearance_of(case, path, guarded, k) for k, path in enumerate(paths)) > 0.003


@pytest.mark.parametrize("toward", [0.5, 1.5])
def test_a_tall_thing_that_is_nearer_than_believed_is_not_flown_against(toward: float) -> None:
    """`toward`: rad, the heading from the object to the thing. No beam sees it before the finger is there."""
    way = np.array([np.cos(toward), np.sin(toward), 0.0])
    tower = Body(TALL, Pose.from_rotation_vector([0.0, 0.0, toward], PLACE + 0.11 * way))
    case = case_of("low", LOW, 0, np.random.default_rng(0), surround=lambda *_: [tower])
    true_camera = case.truth @ case.base_T_camera
    offset = Pose.of(np.eye(3), -0.026 * way)
    case = Case(
        *(case.name, 0, case.depth, case.camera, offset.inverse() @ true_camera, case.mask, case.world, offset),
        case.scored,
    )
    planner = planner_of(case, guarded=True)
    paths = [planner.follow_line(line) for line in trace_lines(planner.surface)]
    assert min(clearance_of(case, path, True, 4 * k) for k, path in enumerate(paths)) > 0.003
