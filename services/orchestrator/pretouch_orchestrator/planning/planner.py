"""Chooses the scan to make next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pretouch.geometry import Array
from pretouch.scan_prediction import Prediction
from pretouch.session import Planner
from pretouch.trajectory import APPROACH_SECONDS, Trajectory
from pretouch_orchestrator.planning.candidates import CandidatePath

MIN_RETURNS, GOOD_RETURNS = 0.3, 0.8
"""Samples, of all modules at once, that are expected to return on average: with fewer than the first a scan is not
planned, with fewer than the second only if nothing with more is worth making, over the object or beside it."""
MIN_GAIN = 0.05
"""Decrease of the log expected error below which a scan is not worth the robot's time, unless as many such scans as the
budget allows would reach the tolerance."""
SHORTLIST = 6
"""Options that are predicted a second time, over more of the poses that the estimate leaves possible."""
_PACE = 0.8
"""Share of the largest decrease of the log expected error that the next scan brings at least."""


@dataclass(frozen=True, eq=False)
class Option:
    """A scan that could be made next.

    Attributes:
        span: (start, end) of the part of the candidate's path, s.
        confidence: the proposer's, of the candidate's region; 0 without one.
        modules: of the sensor; some of them may look sideways and see nothing.
    """

    candidate: CandidatePath
    span: tuple[float, float]
    prediction: Prediction
    confidence: float
    modules: int = 1

    @property
    def seconds(self) -> float:
        """s that the robot needs for it, the approach included."""
        return self.span[1] - self.span[0] + APPROACH_SECONDS

    def alone(self) -> CandidatePath:
        """The part as a path of its own, from t = 0 on."""
        piece = self.candidate.path.between(*self.span)
        path = Trajectory(piece.t - piece.t[0], piece.base_T_tip)
        return replace(self.candidate, path=path, spans=((0.0, path.duration),))

    @property
    def visible(self) -> bool:
        """Whether enough of its samples are expected to return for it to be planned."""
        return self.prediction.expected_returns * self.modules >= MIN_RETURNS

    @property
    def well_visible(self) -> bool:
        """Whether most of its samples are expected to return."""
        return self.prediction.expected_returns * self.modules >= GOOD_RETURNS


@dataclass(frozen=True)
class Need:
    """What is left to do.

    Attributes:
        present_error: m, the present estimate's expected error.
        log_ratio: log of the ratio of the present error's quantile to the tolerance; at most 0 once it is met.
        scans: how many more the budget allows.
    """

    present_error: float
    log_ratio: float
    scans: int


def shortlist(options: Sequence[Option], planner: Planner, need: Need) -> list[Option]:
    """The options that `choose` would take first, at most SHORTLIST of them, to be predicted more carefully."""
    scores = _score(options, planner, need)
    return [options[k] for k in np.argsort(-scores, kind="stable")[:SHORTLIST] if np.isfinite(scores[k])]


def choose(options: Sequence[Option], planner: Planner, need: Need) -> Option | None:
    """The best of the options, all of which are visible; None when no scan is worth making.

    `information` maximises the predicted decrease of the log expected error per second, approach included, among the
    scans with which the rest of the budget's scans would reach the tolerance or that bring at least 80 % of the largest
    decrease. `confidence` follows the proposer's own scores, and takes the longest beginning that the budget allows.
    """
    best = shortlist(options, planner, need)[:1]
    return best[0] if best else None


def _score(options: Sequence[Option], planner: Planner, need: Need) -> Array:
    """(n,): the higher the better; -inf for scans that are not worth making."""
    if planner is Planner.CONFIDENCE:
        ranked = sorted(range(len(options)), key=lambda k: (options[k].confidence, options[k].seconds), reverse=True)
        return -np.argsort(ranked).astype(np.float64)
    gains = np.log(need.present_error / np.array([option.prediction.expected_error for option in options]))
    pace = need.log_ratio / need.scans
    wanted = max(min(MIN_GAIN, pace), min(pace, _PACE * float(gains.max(initial=0.0))))
    seconds = np.array([option.seconds for option in options])
    return np.asarray(np.where(gains >= wanted, gains / seconds, -np.inf), dtype=np.float64)
