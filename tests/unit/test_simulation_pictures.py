"""The demo's picture and report are complete, for sessions of any length."""

import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pretouch_simulation.demo import Recording
from pretouch_simulation.demo_table import live_table
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.picture import save_picture
from pretouch_simulation.protocol import Case, make_case
from pretouch_simulation.report import save_report
from rich.console import Console

from pretouch.estimate import Prior, from_prior
from pretouch.geometry import Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.session import BudgetUsed, Planner, Proposer, Region, ScanSummary, Session, State


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case("drill", MAKERS["drill"](), 0)


def recorded(case: Case, scans: int) -> Recording:
    """A session that halves its error with each scan."""
    v, u = (x.mean() for x in np.nonzero(case.mask))
    regions = tuple(Region(f"region-{k}", RotatedRectangle(u, v, 40 + 9 * k, 30, 0.3 * k), 0.5, 0.01) for k in range(5))
    before = from_prior(Prior(), case.cloud)
    recording = Recording("drill, REST", case)
    for k in range(scans + 1):
        correction = Pose.of(np.eye(3), (1 - 0.5**k) * (case.truth.apply(before.centroid) - before.centroid))
        estimate = replace(before, base_T_correction=correction, modes=(), expected_error=before.expected_error / 2**k)
        summaries = tuple(
            ScanSummary(f"scan-{j}", f"region-{j}", f"region-{j}", 90, 80, 0.3, 6.0, 0.01) for j in range(k)
        )
        state = State.CONVERGED if k == scans else State.AWAITING_SCAN
        used = BudgetUsed(k, 6.0 * k, 0.07 * k)
        recording.states.append(
            Session("1", state, Proposer.RANDOM, Planner.INFORMATION, regions, estimate, None, summaries, used)
        )
        if k:
            recording.points.append(case.truth.apply(case.cloud[:: 50 * k]))
    return recording


@pytest.mark.parametrize("scans", [0, 3])
def test_the_picture_is_drawn(case: Case, tmp_path: Path, scans: int) -> None:
    save_picture([recorded(case, scans)], tmp_path / "picture.png")
    with Image.open(tmp_path / "picture.png") as image:
        assert image.width > 2000
        assert image.height > 600
        assert len(np.unique(np.asarray(image.convert("L")))) > 50


@pytest.mark.parametrize("scans", [0, 3])
def test_the_report_needs_nothing_else_and_says_the_errors(case: Case, tmp_path: Path, scans: int) -> None:
    recording = recorded(case, scans)
    save_report([recording], "A <made> session.", tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", text)
    assert "A &lt;made&gt; session." in text
    for true, expected in zip(recording.true_errors(), recording.expected_errors(), strict=True):
        assert f"<td>{1000 * true:.2f}</td>" in text
        assert f"<td>{1000 * expected:.2f}</td>" in text
    assert text.count("Plotly.newPlot(") >= 3


def test_the_live_table_fits_a_narrow_terminal(case: Case) -> None:
    output = StringIO()
    recording = recorded(case, 3)
    Console(file=output, width=60).print(live_table([recording, Recording("mug, gRPC", case)]))
    text = output.getvalue()
    assert "…" not in text
    assert "converged" in text
    assert "robot s" in text
    assert f"{1000 * recording.true_errors()[-1]:.1f}" in text
