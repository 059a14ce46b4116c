"""When a session ends, and the reason that its client is given."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from pretouch.estimate import MIN_FIT, Estimate, point_error
from pretouch.exhaustion import Exhaustion, exhaustion_problem
from pretouch.session import Session, State
from pretouch_orchestrator.sessions.record import Record


def end_session(record: Record, state: State, reason: dict[str, Any] | None = None) -> Record:
    """Ends the session, `reason` being a problem document; one that has already ended is returned unchanged."""
    if record.state.ended:
        return record
    return replace(record, state=state, next_scan=None, told=(), forecast=None, reason=reason)


def cancel(session: Session) -> Session:
    """The session cancelled; one that has already ended is returned unchanged."""
    return session if session.state.ended else replace(session, state=State.CANCELLED, next_scan=None, forecast=None)


def is_explained(estimate: Estimate) -> bool:
    """Whether the samples are measurements and the estimate explains them."""
    return estimate.fit >= MIN_FIT and not estimate.sensor_problem


def has_converged(record: Record) -> bool:
    """Whether the tolerance's quantile of the mean error at its points is within its error, the samples explained."""
    return is_explained(record.estimate) and error_quantile(record) <= record.request.tolerance.error


def exhaust_session(record: Record, limit: Exhaustion) -> Record:
    """Ends the session without its tolerance met; one that has already ended is returned unchanged.

    The reason is the first that applies: the sensor, a misfit, nothing within range, or else `limit`, which prevents
    another scan.
    """
    cause = _find_cause(record, limit)
    detail, remedy = _DESCRIPTIONS[cause](record)
    return end_session(record, State.EXHAUSTED, exhaustion_problem(cause, detail, remedy))


def _find_cause(record: Record, limit: Exhaustion) -> Exhaustion:
    if record.estimate.sensor_problem:
        return Exhaustion.SENSOR
    if record.estimate.fit < MIN_FIT:
        return Exhaustion.MISFIT
    if record.scans and not any(scan.returns for scan in record.scans):
        return Exhaustion.OUT_OF_RANGE
    return limit


def error_quantile(record: Record) -> float:
    """m: the tolerance's quantile of the mean error at its points."""
    tolerance, estimate = record.request.tolerance, record.estimate
    if tolerance.confidence == 0.95:
        return estimate.error_quantile
    centroid = estimate.base_T_correction.apply(estimate.centroid)
    _, quantile = point_error(
        estimate.covariance, record.corrected_tolerance_points(), centroid, (tolerance.confidence,)
    )
    return float(quantile[0])


def _describe_sensor(record: Record) -> tuple[str, str]:
    return (
        f"After {_pluralize(len(record.scans), 'scan')}: {record.estimate.sensor_problem}",
        "Look at what the finger sends with `pretouch gateway watch`; check its cable and supply, and that ranges are "
        "in metres. Then open a new session.",
    )


def _describe_misfit(record: Record) -> tuple[str, str]:
    estimate = record.estimate
    return (
        f"No pose explains the {_pluralize(estimate.samples, 'sample')}: {estimate.inliers} agree with the best one, "
        f"whose p-value is {estimate.fit:.2g}, less than {MIN_FIT:g}.",
        "Check that the object has not moved since the depth image, that the mask holds it alone, that each base_T_tip "
        "belongs to its range, and that sensor (range_std, beam_half_angle) and prior are not too small. Then open a "
        "new session with a new image.",
    )


def _describe_out_of_range(record: Record) -> tuple[str, str]:
    request = record.request
    samples = sum(scan.samples for scan in record.scans)
    return (
        f"None of the {_pluralize(samples, 'sample')} of {_pluralize(len(record.scans), 'scan')} returned a range "
        f"within {1000 * request.sensor.range_max:g} mm, with a standoff of {1000 * request.scan.standoff:g} mm.",
        "Check that the finger is switched on and that base_T_tip is the sensor's own pose, z along the beam. If so, "
        "lower scan.standoff, or give a smaller prior: the finger keeps clear of every place where the object may be.",
    )


def _describe_scans(record: Record) -> tuple[str, str]:
    spent, budget = record.budget_used.scans, record.request.budget.scans
    detail = f"The session has made {spent} of {_pluralize(budget, 'scan')}."
    return f"{detail} {_describe_accuracy(record)}", _suggest_larger("scans")


def _describe_seconds(record: Record) -> tuple[str, str]:
    spent, budget = record.budget_used.seconds, record.request.budget.seconds
    detail = f"{spent:.1f} of {budget:g} robot seconds are spent, and the rest is not enough for another scan."
    return f"{detail} {_describe_accuracy(record)}", _suggest_larger("seconds")


def _describe_fraction(record: Record) -> tuple[str, str]:
    spent, budget = record.budget_used.fraction, record.request.budget.fraction
    detail = f"{spent:.1%} of the object is scanned, and another scan would exceed the {budget:.1%} allowed."
    return f"{detail} {_describe_accuracy(record)}", _suggest_larger("fraction")


def _describe_nothing_to_gain(record: Record) -> tuple[str, str]:
    scanned, skipped = len(record.scans), len(record.skipped)
    detail = (
        f"After {_pluralize(scanned, 'scan')}, and {_pluralize(skipped, 'path')} that the finger could not reach, no "
        "further scan would tell much."
    )
    return (
        f"{detail} {_describe_accuracy(record)}",
        "Choose another proposer, check that the mask covers the object, make more of it reachable, or request a "
        "larger tolerance.error.",
    )


def _describe_accuracy(record: Record) -> str:
    tolerance, error = record.request.tolerance, error_quantile(record)
    return (
        f"At {100 * tolerance.confidence:.4g} % confidence the error is at most {1000 * error:.1f} mm; "
        f"{1000 * tolerance.error:g} mm were requested."
    )


def _suggest_larger(name: str) -> str:
    return f"Use the estimate as it is, or open a new session with a larger budget.{name} or tolerance.error."


def _pluralize(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


_DESCRIPTIONS = {
    Exhaustion.SENSOR: _describe_sensor,
    Exhaustion.MISFIT: _describe_misfit,
    Exhaustion.OUT_OF_RANGE: _describe_out_of_range,
    Exhaustion.SCANS: _describe_scans,
    Exhaustion.SECONDS: _describe_seconds,
    Exhaustion.FRACTION: _describe_fraction,
    Exhaustion.NOTHING_TO_GAIN: _describe_nothing_to_gain,
}
"""The detail, what happened in numbers, and the remedy of each reason."""
