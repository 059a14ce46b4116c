"""What came of a session and why, in sentences for people."""

from __future__ import annotations

import numpy as np

from pretouch.estimate import MIN_FIT, Estimate
from pretouch.session import Forecast, State, Tolerance
from pretouch_orchestrator.sessions.record import Record

_NAMES = {
    State.AWAITING_SCAN: "Under way",
    State.CONVERGED: "Converged",
    State.EXHAUSTED: "Exhausted",
    State.FAILED: "Failed",
    State.CANCELLED: "Cancelled",
}


def describe_outcome(record: Record) -> str:
    """A paragraph: the state, what it took, how good the estimate is, why the session ended and what to do."""
    estimate, tolerance = record.estimate, record.request.tolerance
    count = len(record.scans)
    effort = f"{count} scan{'' if count == 1 else 's'} and {record.budget_used.seconds:.1f} s of the robot's time"
    parts = [f"{_NAMES[record.state]} after {effort}." if count else f"{_NAMES[record.state]} without a scan."]
    if record.reason is not None:
        parts += [str(record.reason.get(member, "")) for member in ("detail", "remedy")]
    elif record.state is State.CONVERGED:
        parts.append(
            f"The mean error of {describe_points(tolerance)} was to be at most {_mm(tolerance.error)} at "
            f"{100 * tolerance.confidence:.4g} % confidence, and it is."
        )
    elif record.state is State.CANCELLED:
        parts.append("The client cancelled it; the estimate is what was known by then.")
    else:
        parts.append(f"It goes on until the error is at most {_mm(tolerance.error)}, or its budget is spent.")
    return " ".join(part for part in [*parts, *_describe_estimate(estimate, count)] if part)


def describe_correction(estimate: Estimate) -> str:
    """How far the estimate moves and turns the object."""
    correction = estimate.base_T_correction
    shift = np.linalg.norm(correction.apply(estimate.centroid) - estimate.centroid)
    cosine = np.clip((np.trace(correction.rotation) - 1) / 2, -1, 1)
    return f"{_mm(float(shift))} and {np.degrees(np.arccos(cosine)):.1f}°"


def describe_points(tolerance: Tolerance) -> str:
    """Where the error counts."""
    if tolerance.at is None:
        return "the object's points"
    return f"{len(tolerance.at)} given point{'' if len(tolerance.at) == 1 else 's'}"


def describe_forecast(forecast: Forecast) -> str:
    """What the rest of the session is expected to take."""
    return (
        f"{forecast.scans:.1f} more scans in {forecast.seconds:.0f} s, converged with a chance of {forecast.chance:.0%}"
    )


def _describe_estimate(estimate: Estimate, scans: int) -> list[str]:
    """How good the estimate is, and what makes it weak."""
    expected = f"{_mm(estimate.expected_error)} of error are expected, with 95 % probability at most "
    parts = [
        f"The object is corrected by {describe_correction(estimate)}; {expected}{_mm(estimate.error_quantile)}."
        if scans
        else f"Nothing is corrected yet; {expected}{_mm(estimate.error_quantile)}, as the prior says."
    ]
    if estimate.unobservable:
        weakest = estimate.unobservable[0]
        parts.append(f"Least certain, ± one standard deviation: {weakest.text.rstrip('.')}.")
    if estimate.sensor_problem:
        parts.append(f"The samples are not to be trusted: {estimate.sensor_problem}")
    elif estimate.fit < MIN_FIT:
        parts.append(
            f"The samples do not fit this answer (p-value {estimate.fit:.2g}, less than {MIN_FIT:g}): it is wrong, or "
            "the object moved, however small the expected error is."
        )
    return parts


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"
