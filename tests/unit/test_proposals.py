"""Proposed regions follow the paper's rules, are reproducible by seed, and differ from each other."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers.scenes import Box, World
from pretouch_detector.model.weights import Weights
from pretouch_detector.proposals import deep, list_readiness, propose, warm_up
from pretouch_detector.proposals.random import AREA, MIN_OVERLAP

from pretouch.errors import InvalidInput, Unavailable
from pretouch.rectangle import RotatedRectangle
from pretouch.scene import Scene
from pretouch.session import Proposer
from pretouch.tof import Sensor

READY = [proposer for proposer, reason in list_readiness() if not reason]
OF_CANDIDATES = [proposer for proposer in READY if proposer is not Proposer.NARF]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),)).scene()


@pytest.mark.parametrize("proposer", OF_CANDIDATES)
def test_regions_keep_the_rules_of_algorithm_1_and_repeat(scene: Scene, proposer: Proposer) -> None:
    regions = propose(scene, proposer, Sensor(), 20, 7).regions
    assert 10 <= len(regions) <= 20
    u0, v0, u1, v1 = scene.bounds()
    box = shapely.box(u0 - 0.5, v0 - 0.5, u1 - 0.5, v1 - 0.5)
    for region in regions:
        shape = shapely.Polygon(region.rectangle.corners())
        assert AREA[0] - 1e-9 <= shape.area / box.area <= AREA[1] + 1e-9
        assert shape.intersection(box).area / shape.union(box).area >= MIN_OVERLAP - 1e-9
        assert 0 <= region.confidence <= 1
    assert [r.confidence for r in regions] == sorted((r.confidence for r in regions), reverse=True)
    assert regions == propose(scene, proposer, Sensor(), 20, 7).regions
    assert regions != propose(scene, proposer, Sensor(), 20, 8).regions


def test_stability_prefers_perimeters_that_cross_edges_of_a_flat_box(scene: Scene) -> None:
    ranked = propose(scene, Proposer.STABILITY, Sensor(), 20, 0).regions

    def crossings(rectangle: RotatedRectangle) -> int:
        u, v = np.round(rectangle.perimeter()).astype(int).T
        return int((np.diff(scene.mask[v, u].astype(int)) != 0).sum())

    everyone = propose(scene, Proposer.RANDOM, Sensor(), 100, 0).regions
    best = np.mean([crossings(r.rectangle) for r in ranked[:5]])
    assert best > np.mean([crossings(r.rectangle) for r in everyone])


def test_left_out_the_best_ready_proposer_is_taken_and_named(scene: Scene) -> None:
    assert propose(scene, None, Sensor(), 3, 0).proposer is READY[0]


def test_a_proposer_that_is_not_ready_is_refused_with_those_that_are(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deep, "WEIGHTS", Weights(tmp_path))
    with pytest.raises(Unavailable) as raised:
        propose(scene, Proposer.DEEP, Sensor(), 3, 0)
    assert {"random", "narf"} <= set(raised.value.remedy.rstrip(".").removeprefix("Choose one of ").split(", "))


@pytest.mark.parametrize("count", [0, 201])
def test_a_count_out_of_range_is_refused(scene: Scene, count: int) -> None:
    with pytest.raises(InvalidInput):
        propose(scene, None, Sensor(), count, 0)


@pytest.mark.parametrize("proposer", OF_CANDIDATES)
def test_a_strip_that_no_rectangle_overlaps_well_is_refused_and_one_nearly_as_slim_is_not(
    scene: Scene, proposer: Proposer
) -> None:
    def strip(height: int) -> Scene:
        mask = np.zeros_like(scene.mask)
        mask[100 : 100 + height, 10:310] = True
        return Scene(scene.depth, scene.camera, scene.base_T_camera, mask, scene.table)

    assert propose(strip(8), proposer, Sensor(), 5, 0).regions
    with pytest.raises(InvalidInput, match="300 x 1 pixels"):
        propose(strip(1), proposer, Sensor(), 5, 0)


def test_naming_the_proposers_does_not_import_numba() -> None:
    script = "import sys, pretouch_detector.proposals; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], timeout=120, check=False).returncode == 0


def test_after_the_warm_up_a_request_compiles_nothing(scene: Scene) -> None:
    warm_up()
    ours = [module for name, module in sys.modules.items() if name.startswith("pretouch_detector.")]
    kernels = [value for module in ours for value in vars(module).values() if hasattr(value, "signatures")]
    before = [len(kernel.signatures) for kernel in kernels]
    for proposer in READY:
        propose(scene, proposer, Sensor(), 20, 0)
    assert [len(kernel.signatures) for kernel in kernels] == before
    assert sum(before) > 0
