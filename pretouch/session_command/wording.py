"""A session in words: what came of it and why, how certain it is, what to do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.text import Text

from pretouch.errors import TYPE_PREFIX
from pretouch.estimate import Estimate
from pretouch.exhaustion import Exhaustion
from pretouch.geometry import vector_from_rotation
from pretouch.session import Forecast, ScanPlan, ScanSummary, Session, State
from pretouch.session_warning import SessionWarning

STYLES = {
    State.AWAITING_SCAN: "cyan",
    State.CONVERGED: "green",
    State.EXHAUSTED: "yellow",
    State.FAILED: "red",
    State.CANCELLED: "magenta",
}
_CERTAIN = 0.99
"""Weight of the first mode from which others are not worth a word."""


def clean(text: object) -> str:
    """Text in one line of printable characters: nothing in it can steer the terminal."""
    return "".join(each if each.isprintable() else " " if each.isspace() else "\ufffd" for each in str(text))


def millimetres(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def count_scans(session: Session) -> str:
    scans = len(session.scans)
    return f"{scans} scan{'' if scans == 1 else 's'}" if scans else "no scan"


def describe_state(session: Session) -> str:
    """How far the session has come, to follow its name."""
    match session.state:
        case State.AWAITING_SCAN if session.scans:
            return f"awaits another scan, after {count_scans(session)}"
        case State.AWAITING_SCAN:
            return "awaits its first scan"
        case State.CONVERGED:
            return f"has converged after {count_scans(session)}: its tolerance is met"
        case State.EXHAUSTED:
            return f"is exhausted after {count_scans(session)}: its tolerance is not met"
        case State.FAILED:
            return f"has failed after {count_scans(session)}"
        case State.CANCELLED:
            return f"was cancelled after {count_scans(session)}"


def describe(session: Session) -> Iterator[Text]:
    """What came of the session and why, how certain the answer is, and what it says; a paragraph each."""
    text = Text(f"Session {clean(session.id)} ")
    text.append(f"{describe_state(session)}.", f"bold {STYLES[session.state]}")
    reason = session.reason or {}
    for member in ("detail", "remedy"):
        if reason.get(member):
            text.append(f" {clean(reason[member])}")
    yield text
    if reason_name(session) in (Exhaustion.MISFIT, Exhaustion.SENSOR):
        yield Text("The estimate is not to be used.")
    else:
        yield Text(" ".join(_accuracy(session.estimate)))
        if session.estimate.samples:
            yield Text(_answer(session.estimate))


def _accuracy(estimate: Estimate) -> Iterator[str]:
    yield (
        f"The mean error of the points that count is expected to be {millimetres(estimate.expected_error)}, and is at "
        f"most {millimetres(estimate.error_quantile)} with 95 % confidence."
    )
    if estimate.samples and estimate.unobservable:
        directions = "; ".join(clean(each.text) for each in estimate.unobservable)
        yield f"What the samples tell least about: {directions}."
    if len(estimate.modes) > 1 and estimate.modes[0].weight < _CERTAIN:
        yield (
            f"{len(estimate.modes)} different poses explain the samples; this one has a probability of "
            f"{percent(estimate.modes[0].weight)}."
        )


def _answer(estimate: Estimate) -> str:
    correction = estimate.base_T_correction
    shift = 1000 * (correction.apply(estimate.centroid) - estimate.centroid)
    degrees = np.degrees(np.linalg.norm(vector_from_rotation(correction.rotation)))
    return (
        f"The correction moves the object's centroid by ({', '.join(f'{each:.1f}' for each in shift)}) mm in base and "
        f"turns it by {degrees:.1f} deg; {estimate.inliers} of {estimate.samples} samples agree with it."
    )


def reason_name(session: Session) -> str:
    """The last part of the reason's type; empty without a reason."""
    return clean((session.reason or {}).get("type", "")).removeprefix(TYPE_PREFIX)


def describe_warning(warning: SessionWarning) -> Text:
    return Text.assemble(
        (f"Warning {clean(warning.code)}: ", "bold yellow"), f"{clean(warning.detail)} {clean(warning.remedy)}"
    )


def describe_scan(scan: ScanSummary) -> Text:
    """A scan in one line."""
    return Text.assemble(
        (clean(scan.scan_id), "bold"),
        f" along {clean(scan.path_id)}: {scan.samples} samples, {describe_returns(scan)} returned, "
        f"{scan.duration:.1f} s; {millimetres(scan.expected_error)} expected",
    )


def describe_returns(scan: ScanSummary) -> str:
    return percent(scan.returns / scan.samples) if scan.samples else "none"


def describe_forecast(forecast: Forecast) -> Text:
    """What the rest of the session is expected to take, in one line."""
    return Text(
        f"expected: {forecast.scans:.1f} more scans in {forecast.seconds:.0f} s, converged with a chance of "
        f"{percent(forecast.chance)}",
        "dim",
    )


def describe_plan(plan: ScanPlan) -> Text:
    """The next scan in one line."""
    return Text(
        f"next: {clean(plan.scan_id)} along {clean(plan.path_id)}, {millimetres(plan.path.length)} in "
        f"{plan.path.duration:.1f} s, {percent(plan.expected_returns)} expected to return",
        "dim",
    )
