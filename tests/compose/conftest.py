"""A Docker engine, and its compose command, for all tests of containers."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from helpers.deployment import REPOSITORY, SECONDS, run

ENGINE = Path(os.environ.get("PRETOUCH_SHARED", REPOSITORY.parent / "shared")) / "tools" / "docker-engine"


def succeeds(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, timeout=SECONDS, check=False).returncode == 0
    except OSError:
        return False


@pytest.fixture(scope="session")
def engine() -> Iterator[None]:
    """A Docker engine: the machine's own, or one that is started for these tests and ended after them."""
    there = succeeds("docker", "info")
    if ENGINE.exists() and os.geteuid() == 0:
        run(ENGINE, seconds=1200)
    elif not there:
        pytest.skip(f"no Docker engine runs here, and {ENGINE} is not there or may not start one (needs root)")
    yield
    if not there:
        run(ENGINE, "stop")


@pytest.fixture(scope="session")
def compose(engine: None) -> Sequence[str]:
    """The compose command of this machine."""
    if succeeds("docker", "compose", "version"):
        return ("docker", "compose")
    if shutil.which("docker-compose"):
        return ("docker-compose",)
    pytest.skip("there is neither `docker compose` nor docker-compose")
