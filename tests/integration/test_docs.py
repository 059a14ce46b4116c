"""The documentation site builds from what is there, and none of its links is broken."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="needs pretouch[docs]")
ROOT = Path(__file__).resolve().parents[2]
MADE = {
    "rest": "POST /v1/sessions/{session_id}/scans/{scan_id}",
    "grpc": "PredictScans",
    "cli": "--metrics-port",
    "errors": "method-not-allowed",
    "sdk": "create_session",
}
"""Something on each page that is made from the code."""


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    site = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert ", 0 broken" in done.stderr
    for page, text in MADE.items():
        assert text in (site / "reference" / f"{page}.html").read_text(), page
