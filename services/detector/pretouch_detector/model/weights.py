"""The trained network in `weights/`: checked when it is read, run by onnxruntime.

It consists of `scorer.onnx` and of `scorer.json`, which describes the network's input:

    {"format": 1, "channels": ["height", ...], "size": 128, ...}
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pretouch.errors import Unavailable
from pretouch.geometry import Array
from pretouch_detector.model.encoding import CHANNELS, SIZE, Encoding

FORMAT = 1
"""Incremented when the inputs or outputs of a trained network change."""
FOLDER = Path(__file__).parents[1] / "weights"
THREADS = 2
_GRAPH, _DESCRIPTION = "scorer.onnx", "scorer.json"
_REMEDY = "Reinstall pretouch[detector], or restore the files."


@dataclass(frozen=True, eq=False)
class Network:
    """A trained network; threads may share it.

    Attributes:
        session: of onnxruntime. Inputs `image` (1, C, S, S) and `rectangles` (n, 5) as `Encoding` gives them, and
            `analytic` (n,), m; output `log_error` (n, 2): logs of the mean error, m, and of the standard deviation of
            the error's logarithm.
    """

    session: Any

    def predict_errors(self, encoding: Encoding, rectangles: ArrayLike, analytic: ArrayLike) -> Array:
        """(n,), m: the error that a scan of each perimeter would leave.

        Args:
            rectangles: (n, 5) in the scene's pixels.
            analytic: (n,), m: as by `proposals.information`.
        """
        inputs = {
            "image": encoding.image[None],
            "rectangles": encoding.normalise(rectangles),
            "analytic": np.asarray(analytic, dtype=np.float32),
        }
        (answer,) = self.session.run(["log_error"], inputs)
        return np.exp(answer[:, 0].astype(np.float64))


def load(folder: Path, threads: int) -> Network:
    """Loads a network and runs it once.

    Args:
        threads: for one inference.

    Raises:
        Unavailable: a file is missing or damaged, or of another version, or onnxruntime is not installed.
    """
    _check_description(folder / _DESCRIPTION)
    network = Network(_open_session(folder / _GRAPH, threads))
    _check_answers(network)
    return network


class Weights:
    """The network of a folder, read once when it is first needed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = Lock()
        self._outcome: Network | Unavailable | None = None

    def get_network(self, threads: int = THREADS) -> Network:
        """The network; `threads` counts for the first call only.

        Raises:
            Unavailable: as `load`.
        """
        with self._lock:
            if self._outcome is None:
                try:
                    self._outcome = load(self._folder, threads)
                except Unavailable as error:
                    self._outcome = error
        if isinstance(self._outcome, Unavailable):
            raise Unavailable(self._outcome.detail, self._outcome.remedy)
        return self._outcome


def _check_description(path: Path) -> None:
    """Refuses a network that this version cannot use."""
    about = _read_description(path)
    if about.get("format") != FORMAT:
        raise Unavailable(
            f"The weights are of format {about.get('format')}; this version reads {FORMAT}.",
            "Train anew, or use the version that wrote them.",
        )
    if (about.get("channels"), about.get("size")) != (list(CHANNELS), SIZE):
        raise Unavailable(
            f"The weights read {about.get('channels')} at size {about.get('size')}; this version gives "
            f"{list(CHANNELS)} at size {SIZE}.",
            "Train anew, or use the version that wrote them.",
        )


def _check_answers(network: Network) -> None:
    """Runs the network on an empty image and three rectangles; any other answer than three errors is refused."""
    nothing = Encoding(np.zeros((len(CHANNELS), SIZE, SIZE), np.float32), (0.0, 0.0), 1.0)
    try:
        answer = network.predict_errors(nothing, [(0.0, 0.0, 1.0, 1.0, 0.0)] * 3, [0.01] * 3)
    except Exception as error:  # onnxruntime raises many kinds of error
        raise Unavailable(f"The weights hold another network: {_take_first_line(error)}", _REMEDY) from error
    if answer.shape != (3,) or not np.isfinite(answer).all():
        raise Unavailable(f"The weights answer {answer}, not three errors.", _REMEDY)


def _read_description(path: Path) -> dict[str, Any]:
    try:
        about = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise Unavailable(f"The weights' description {path.name} is missing.", _REMEDY) from error
    except (OSError, ValueError) as error:
        raise Unavailable(f"The weights' description {path.name} cannot be read.", _REMEDY) from error
    if not isinstance(about, dict):
        raise Unavailable(f"The weights' description {path.name} cannot be read.", _REMEDY)
    return about


def _open_session(path: Path, threads: int) -> Any:
    """An onnxruntime session of the graph.

    From 1.32 on onnxruntime sends telemetry to its maker unless this variable is set before it is imported.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"
    try:
        import onnxruntime
    except ImportError as error:
        raise Unavailable("onnxruntime is not installed.", "Install pretouch[detector].") from error
    try:
        graph = path.read_bytes()
    except OSError as error:
        raise Unavailable(f"The weights {path.name} are missing.", _REMEDY) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4  # failures are raised, so they need not be logged
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # leaves the cores to the other services
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many kinds of error
        raise Unavailable(f"The weights {path.name} are damaged: {_take_first_line(error)}", _REMEDY) from error


def _take_first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
