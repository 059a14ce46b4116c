"""The training targets of a labelled view: the mean or the worst of its trials; unknown values stay NaN."""

from pathlib import Path

import numpy as np
import pytest
from helpers.scenes import Box, World
from pretouch_detector.model.encoding import CHANNELS, SIZE
from pretouch_detector.proposals.information import predict_errors_after_scans
from pretouch_detector.training.dataset import Dataset, Example, write
from pretouch_detector.training.targets import ACHIEVED, EXPECTED, PREDICTED, load, targets_of

from pretouch.errors import InvalidInput
from pretouch.tof import Sensor

NAN = np.nan
CONE = Sensor(beam_half_angle=0.2)
SCENE = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),)).scene()
U0, V0, U1, V1 = SCENE.bounds()
RECTANGLES = np.array([[0.5 * (U0 + U1), 0.5 * (V0 + V1), 20.0 + k, 15.0, 0.1 * k] for k in range(3)])
EXAMPLE = Example(
    "box-0", "box", SCENE, CONE, RECTANGLES, np.array([[0.002, 0.004], [NAN, NAN], [0.01, 0.02]]),
    np.array([[0.003, 0.005], [NAN, NAN], [NAN, NAN]]), np.array([0.006, 0.007, NAN]), {},
)  # fmt: skip


@pytest.mark.parametrize(("worst", "achieved"), [(False, [0.003, NAN, 0.015]), (True, [0.004, NAN, 0.02])])
def test_targets(worst: bool, achieved: list[float]) -> None:
    targets = targets_of(EXAMPLE, worst)
    assert targets.image.shape == (len(CHANNELS), SIZE, SIZE)
    np.testing.assert_allclose(targets.errors[:, ACHIEVED], achieved, rtol=1e-6)
    np.testing.assert_allclose(targets.errors[:, EXPECTED], [0.004, NAN, NAN], rtol=1e-6)
    np.testing.assert_allclose(targets.errors[:, PREDICTED], [0.006, 0.007, NAN], rtol=1e-6)
    np.testing.assert_allclose(targets.analytic, predict_errors_after_scans(SCENE, CONE, RECTANGLES)[0], rtol=1e-6)
    assert (targets.analytic > 1.01 * predict_errors_after_scans(SCENE, Sensor(), RECTANGLES)[0]).all()
    assert np.abs(targets.rectangles[:, :2]).max() < 0.02  # in the middle of the square


def test_a_datasets_kind_says_which_and_a_side_without_views_is_refused(tmp_path: Path) -> None:
    for kind, achieved in (("scans", 0.003), ("trials", 0.004)):
        dataset = Dataset.create(tmp_path / kind, {"recipe": {"kind": kind}, "command": ""})
        write(dataset.path("train", "box-0"), EXAMPLE)
        (targets,) = load([tmp_path / kind], "train")
        assert targets.errors[0, ACHIEVED] == pytest.approx(achieved, rel=1e-4)
    with pytest.raises(InvalidInput, match="validation"):
        load([tmp_path / "scans"], "validation")
