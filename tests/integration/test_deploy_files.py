"""The systemd unit, as systemd itself reads it, and the script that makes certificates."""

from __future__ import annotations

import re
import shutil
import ssl
import stat
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
TIMEOUT = 60


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_the_unit_is_valid_and_leaves_little_exposed(tmp_path: Path) -> None:
    unit = tmp_path / "pretouch.service"
    text = (DEPLOY / "systemd" / "pretouch.service").read_text()
    unit.write_text(text.replace("/opt/pretouch/bin/pretouch", "/bin/true"))
    verified = subprocess.run(
        ["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=TIMEOUT, check=False
    )
    assert (verified.returncode, verified.stderr) == (0, "")
    checked = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", unit],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    exposure = re.search(r"Overall exposure level for \S+: ([\d.]+)", checked.stdout)
    assert exposure is not None, checked.stdout + checked.stderr
    assert float(exposure[1]) < 2.5


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_certificates_serve_both_ends_and_are_kept(tmp_path: Path) -> None:
    folder = tmp_path / "certificates"
    script = DEPLOY / "mtls" / "make-certificates"
    subprocess.run([script, folder], capture_output=True, timeout=TIMEOUT, check=True)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert stat.S_IMODE((folder / "ca.key").stat().st_mode) == 0o600
    for name in ("detector", "registrar", "gateway", "orchestrator", "robot"):
        both = ["openssl", "verify", "-CAfile", folder / "ca.pem", "-purpose"]
        for purpose in ("sslserver", "sslclient"):
            subprocess.run([*both, purpose, folder / f"{name}.pem"], capture_output=True, timeout=TIMEOUT, check=True)
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    subprocess.run([script, folder], capture_output=True, timeout=TIMEOUT, check=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
