"""Synthetic runs of an evaluation, for tests of its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pretouch_simulation.evaluation_rows import Detail, Row, Run, RunKey

DETAIL = Detail((0.1,) * 6, (0.5,) * 6, 4.0, 0.008, "translation along the vertical of the table", 90, 60)
KEY = RunKey("mug", 0, "point_to_plane", "ideal", "kinect")


def run_of(key: RunKey, *errors: float, initial: float = 0.02, distances2: Sequence[float] = ()) -> Run:
    """A run with these errors, m, after its scans: 8 robot seconds and a tenth of the object each, 4 mm expected.

    Args:
        distances2: of the truth in the stated metric, a number for each scan; left out: 4.
    """
    rows = tuple(
        Row(
            mesh=key.mesh,
            view=key.view,
            scan=scan,
            proposer="random",
            engine=key.engine,
            planner="information",
            sensor=key.sensor,
            initial_error=initial,
            error=error,
            expected_error=0.004,
            covered=scan > 1,
            state="awaiting_scan",
            fraction=0.1 * scan,
            robot_seconds=8.0 * scan,
            compute_ms=50.0,
            camera=key.camera,
            scan_seconds=8.0,
            returns=0.5,
            scene=key.scene,
            frame=key.frame,
        )
        for scan, error in enumerate(errors, start=1)
    )
    details = tuple(replace(DETAIL, distance2=d2) for d2 in distances2 or [4.0] * len(rows))
    return Run(**key._asdict(), initial_error=initial, rows=rows, details=details)


def ended(run: Run, state: str, error_fitted: float | None = None) -> Run:
    """The run with its last scan's state and, if given, its fitted error, m."""
    last = replace(run.rows[-1], state=state, error_fitted=error_fitted)
    return replace(run, rows=(*run.rows[:-1], last))
