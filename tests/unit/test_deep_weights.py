"""With unusable weights `deep` is not ready and gives the reason; other proposers still work."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import made_network
from helpers.scenes import Box, World
from pretouch_detector.model.encoding import CHANNELS
from pretouch_detector.model.weights import FORMAT, Weights
from pretouch_detector.proposals import deep, list_readiness, propose

from pretouch.errors import Unavailable, problem
from pretouch.session import Proposer
from pretouch.tof import Sensor

OTHERS = [Proposer.STABILITY, Proposer.RANDOM, Proposer.NARF]
SCENE = World((Box.standing((0.10, 0.06, 0.05), yaw=0.4),)).scene()


def cut(name: str, share: float) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(share * len(data))])

    return change


def written(**facts: object) -> Callable[[Path], object]:
    return lambda folder: made_network.write(folder, **facts)  # type: ignore[arg-type]


BAD = {
    "no network": (lambda folder: (folder / "scorer.onnx").unlink(), "scorer.onnx are missing"),
    "no description": (lambda folder: (folder / "scorer.json").unlink(), "scorer.json is missing"),
    "a truncated network": (cut("scorer.onnx", 0.6), "scorer.onnx are damaged"),
    "an empty network": (cut("scorer.onnx", 0.0), "scorer.onnx are damaged"),
    "a truncated description": (cut("scorer.json", 0.5), "scorer.json cannot be read"),
    "a description of another kind": (lambda folder: (folder / "scorer.json").write_text("[1]"), "cannot be read"),
    "another format": (written(format=FORMAT + 1), f"format {FORMAT + 1}; this version reads {FORMAT}"),
    "no format": (written(format=None), "format None"),
    "other channels": (written(channels=["depth"]), "['depth']"),
    "another size": (written(size=64), "at size 64"),
    "another network": (written(output="boxes"), "another network"),
    "no numbers": (written(bias=float("nan")), "nan"),
}


@pytest.mark.parametrize("name", BAD)
def test_weights_that_cannot_be_used(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    change, word = BAD[name]
    change(made_network.write(tmp_path / "weights"))
    monkeypatch.setattr(deep, "WEIGHTS", Weights(tmp_path / "weights"))
    states = list_readiness()
    assert states[:-1] == [(other, "") for other in OTHERS]
    assert states[-1][0] is Proposer.DEEP
    assert word in states[-1][1]
    assert str(tmp_path) not in states[-1][1]
    with pytest.raises(Unavailable) as raised:
        propose(SCENE, Proposer.DEEP, Sensor(), 3, 0)
    assert word in raised.value.detail
    assert raised.value.remedy == "Choose one of stability, random, narf."
    assert problem(raised.value)["status"] == 503
    assert propose(SCENE, None, Sensor(), 3, 0).proposer is Proposer.STABILITY


def test_without_onnxruntime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deep, "WEIGHTS", Weights(made_network.write(tmp_path / "weights")))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    assert dict(list_readiness())[Proposer.DEEP] == "onnxruntime is not installed."


def test_weights_that_fit_make_deep_the_best(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deep, "WEIGHTS", Weights(made_network.write(tmp_path / "weights")))
    assert list_readiness() == [(proposer, "") for proposer in (Proposer.DEEP, *OTHERS)]
    assert propose(SCENE, None, Sensor(), 3, 0).proposer is Proposer.DEEP


def test_the_weights_that_are_shipped_make_deep_the_best_and_know_a_bad_region_from_a_good_one() -> None:
    assert list_readiness()[0] == (Proposer.DEEP, "")
    u0, v0, u1, v1 = SCENE.bounds()
    across = (0.5 * (u0 + u1), 0.5 * (v0 + v1), 0.7 * (u1 - u0), 0.7 * (v1 - v0), 0.3)
    corner = (u0, v0, 0.2 * (u1 - u0), 0.2 * (v1 - v0), 0.0)
    good, bad = deep.predict_errors(deep.WEIGHTS.get_network(), SCENE, Sensor(), np.array([across, corner]))
    assert 0.0005 < good < bad < 0.03


def test_the_network_is_read_once(tmp_path: Path) -> None:
    folder = made_network.write(tmp_path / "weights")
    weights = Weights(folder)
    network = weights.get_network()
    (folder / "scorer.onnx").unlink()
    assert weights.get_network() is network


def test_naming_the_proposers_imports_no_onnxruntime_and_asking_deep_no_torch(tmp_path: Path) -> None:
    made_network.write(tmp_path / "weights")
    script = (
        "import sys, pathlib, pretouch_detector.proposals.deep as deep, pretouch_detector.model.weights as weights\n"
        "assert 'onnxruntime' not in sys.modules\n"
        f"deep.WEIGHTS = weights.Weights(pathlib.Path({str(tmp_path / 'weights')!r}))\n"
        "assert not deep.explain_unready(), deep.explain_unready()\n"
        "assert 'onnxruntime' in sys.modules\n"
        "sys.exit('torch' in sys.modules)"
    )
    home = tmp_path / "home"
    home.mkdir()
    environment = os.environ | {"HOME": str(home)}
    assert subprocess.run([sys.executable, "-c", script], timeout=120, check=False, env=environment).returncode == 0
    assert list(home.iterdir()) == [], "onnxruntime's telemetry is on"


def test_the_error_is_the_exponential_of_the_answer(tmp_path: Path) -> None:
    network = Weights(made_network.write(tmp_path / "weights", (0, 0, 0.5, 0, 0), -1.0, 0.5)).get_network()
    encoding = deep.encode(SCENE)
    assert encoding.image.shape[0] == len(CHANNELS)
    rectangles = np.array([(60.0, 50, 20, 10, 0.1), (70.0, 55, 30, 12, 0.2)])
    analytic = np.array([0.004, 0.009])
    expected = np.exp(-1.0 + 0.5 * rectangles[:, 2] / encoding.half) * np.sqrt(analytic)
    np.testing.assert_allclose(network.predict_errors(encoding, rectangles, analytic), expected, rtol=1e-5)
