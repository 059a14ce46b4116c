"""The rotation of a symmetric object about its axis is not observable, and keeps the prior's uncertainty."""

import numpy as np
import pytest
from pretouch_registrar.engines import camera_model
from pretouch_registrar.registration import Registrar, Settings
from pretouch_simulation.labels.view import view_of
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import Case, make_case

from pretouch.tof import Scan, Sensor

REGISTRAR = Registrar()
SETTINGS = Settings()
UP = np.array([0.0, 0.0, 1.0])


def crossing(case: Case, seed: int) -> Scan:
    """Straight down along two lines over the object, 5 cm above it."""
    rng = np.random.default_rng(seed)
    points = case.truth.apply(case.cloud)
    middle, height = points.mean(axis=0), points[:, 2].max() + 0.05
    along = np.linspace(-0.06, 0.06, 60)
    offsets = np.concatenate([np.column_stack([along, 0 * along]), np.column_stack([0 * along, along])])
    origins = np.column_stack([middle[:2] + offsets, np.full(len(offsets), height)])
    down = np.tile(-UP, (len(origins), 1))
    ranges = case.world.trace(origins, down).distances + 0.0015 * rng.standard_normal(len(origins))
    return Scan(origins, down, np.where(ranges < Sensor().range_max, ranges, np.nan))


def turn_std(name: str, seed: int) -> float:
    """rad, about the vertical, after one scan."""
    case = make_case(name, MAKERS[name](), 0, seed)
    solution = REGISTRAR.solve(view_of(case).scene, [crossing(case, seed)], SETTINGS)
    return float(np.sqrt(solution.covariance[2, 2]))


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["can", "bottle"])
def test_the_turn_of_a_round_thing_stays_as_unknown_as_before(name: str, seed: int) -> None:
    assert turn_std(name, seed) == pytest.approx(SETTINGS.prior.rotation_std, rel=0.1)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", ["box", "drill"])
def test_other_things_have_no_free_turn(name: str, seed: int) -> None:
    assert camera_model.build(view_of(make_case(name, MAKERS[name](), 0, seed)).scene).free_turn is None
