"""The trained networks in `weights/`: checked when they are read, run by onnxruntime.

A network is two files: `<design>.onnx`, and `<design>.json`, which says what the network reads:

    {"format": 1, "design": "scorer", "channels": ["height", ...], "size": 128, ...}
"""

from __future__ import annotations

import json
from collections.abc import Callable
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
"""Raised when a network trained before reads or answers something else than one trained now."""
FOLDER = Path(__file__).parents[1] / "weights"
THREADS = 2
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

    def errors(self, encoding: Encoding, rectangles: ArrayLike, analytic: ArrayLike) -> Array:
        """(n,), m: the error that a scan of each perimeter would leave.

        Args:
            rectangles: (n, 5) in the scene's pixels.
            analytic: (n,), m: what `proposals.information` works out for each.
        """
        inputs = {
            "image": encoding.image[None],
            "rectangles": encoding.normalised(rectangles),
            "analytic": np.asarray(analytic, dtype=np.float32),
        }
        (answer,) = self.session.run(["log_error"], inputs)
        return np.exp(answer[:, 0].astype(np.float64))


def load(folder: Path, design: str, threads: int) -> Network:
    """Reads a network and asks it once.

    Args:
        threads: that one question may occupy.

    Raises:
        Unavailable: a file is missing or damaged, or of another version, or onnxruntime is not installed.
    """
    check_description(folder, design)
    network = Network(session(folder / f"{design}.onnx", threads))
    check_answers(design, lambda nothing, three: network.errors(nothing, three, [0.01] * 3))
    return network


class Weights:
    """The network `design` of a folder, read once when it is first needed."""

    def __init__(self, folder: Path, design: str) -> None:
        self._folder, self._design = folder, design
        self._lock = Lock()
        self._outcome: Network | Unavailable | None = None

    def network(self, threads: int = THREADS) -> Network:
        """The network; `threads` counts for the first call only.

        Raises:
            Unavailable: as `load`.
        """
        with self._lock:
            if self._outcome is None:
                try:
                    self._outcome = load(self._folder, self._design, threads)
                except Unavailable as error:
                    self._outcome = error
        if isinstance(self._outcome, Unavailable):
            raise Unavailable(self._outcome.detail, self._outcome.remedy)
        return self._outcome


def check_description(folder: Path, design: str) -> None:
    """Sees to it that `<design>.json` tells of a network that this version can ask.

    Raises:
        Unavailable: it is missing, damaged, or of another version.
    """
    about = _described(folder / f"{design}.json")
    if about.get("format") != FORMAT:
        raise Unavailable(
            f"The weights {design} are of format {about.get('format')}; this version reads {FORMAT}.",
            "Train anew, or use the version that wrote them.",
        )
    if (about.get("channels"), about.get("size")) != (list(CHANNELS), SIZE):
        raise Unavailable(
            f"The weights {design} read {about.get('channels')} at size {about.get('size')}; this version gives "
            f"{list(CHANNELS)} at size {SIZE}.",
            "Train anew, or use the version that wrote them.",
        )


def check_answers(design: str, errors: Callable[[Encoding, ArrayLike], Array]) -> None:
    """Asks for three errors on an empty image.

    Raises:
        Unavailable: that is not what comes.
    """
    nothing = Encoding(np.zeros((len(CHANNELS), SIZE, SIZE), np.float32), (0.0, 0.0), 1.0)
    try:
        answer = errors(nothing, [(0.0, 0.0, 1.0, 1.0, 0.0)] * 3)
    except Exception as error:  # onnxruntime raises many kinds
        raise Unavailable(f"The weights {design} hold another network: {_first_line(error)}", _REMEDY) from error
    if answer.shape != (3,) or not np.isfinite(answer).all():
        raise Unavailable(f"The weights {design} answer {answer}, not three errors.", _REMEDY)


def _described(path: Path) -> dict[str, Any]:
    try:
        about = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise Unavailable(f"The weights' description {path.name} is missing.", _REMEDY) from error
    except (OSError, ValueError) as error:
        raise Unavailable(f"The weights' description {path.name} cannot be read.", _REMEDY) from error
    if not isinstance(about, dict):
        raise Unavailable(f"The weights' description {path.name} cannot be read.", _REMEDY)
    return about


def session(path: Path, threads: int) -> Any:
    """An onnxruntime session of the graph.

    Raises:
        Unavailable: it is missing or damaged, or onnxruntime is not installed.
    """
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
    options.log_severity_level = 4  # what fails is raised
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # the machine has other services
    try:
        return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many kinds
        raise Unavailable(f"The weights {path.name} are damaged: {_first_line(error)}", _REMEDY) from error


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
