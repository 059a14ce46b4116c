"""The two-stage design as it is served: two graphs, run by onnxruntime."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pretouch.geometry import Array
from pretouch_detector.model.encoding import Encoding
from pretouch_detector.model.rcnn_proposals import Allowed, Head, propose
from pretouch_detector.model.weights import check_answers, check_description, session


@dataclass(frozen=True, eq=False)
class TwoStageNetwork:
    """A trained network; threads may share it.

    Attributes:
        first: session of rcnn.onnx: `image` (1, C, S, S) -> `features`, `objectness` (A,), `deltas` (A, 6).
        second: session of rcnn-head.onnx: `features`, `rectangles` (n, 5) -> `score` (n,), `deltas` (n, 6), `log_error`
            (n, 2).
    """

    first: Any
    second: Any

    def errors(self, encoding: Encoding, rectangles: ArrayLike) -> Array:
        """(n,), m: the error that a scan of each perimeter would leave; rectangles (n, 5) in the scene's pixels."""
        features, _, _ = self._first(encoding)
        _, _, logs = self._head(features)(encoding.normalised(rectangles))
        return np.exp(logs[:, 0].astype(np.float64))

    def proposed(self, encoding: Encoding, allowed: Allowed, count: int) -> tuple[Array, Array]:
        """The best rectangles of the whole image, and their errors.

        Args:
            allowed: (n, 5) in the scene's pixels -> (n,), which may be proposed.
            count: the most that are wanted.

        Returns:
            (k, 5) in the scene's pixels, the best first, and (k,), m.
        """
        features, objectness, deltas = self._first(encoding)

        def may(rectangles: Array) -> NDArray[np.bool_]:
            return allowed(encoding.pixels(rectangles))

        rectangles, errors = propose(objectness, deltas, self._head(features), may, count)
        return encoding.pixels(rectangles), errors

    def _first(self, encoding: Encoding) -> list[NDArray[np.float32]]:
        outputs: list[NDArray[np.float32]] = self.first.run(
            ["features", "objectness", "deltas"], {"image": encoding.image[None]}
        )
        return outputs

    def _head(self, features: NDArray[np.float32]) -> Head:
        def head(rectangles: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
            inputs = {"features": features, "rectangles": rectangles}
            score, deltas, logs = self.second.run(["score", "deltas", "log_error"], inputs)
            return score, deltas, logs

        return head


def load(folder: Path, threads: int) -> TwoStageNetwork:
    """Reads the network `rcnn` and asks it once.

    Args:
        threads: that one question may occupy.

    Raises:
        Unavailable: a file is missing or damaged, or of another version, or onnxruntime is not installed.
    """
    check_description(folder, "rcnn")
    network = TwoStageNetwork(session(folder / "rcnn.onnx", threads), session(folder / "rcnn-head.onnx", threads))
    check_answers("rcnn", network.errors)
    return network
