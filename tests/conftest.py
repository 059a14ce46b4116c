"""Fixtures that several suites share. This file also puts `tests/` on the path, so that `helpers` can be imported."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.fake_upstream import FakeUpstream
from helpers.postgresql import PostgresqlServer
from helpers.stores import KINDS
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

settings.register_profile("untimed", deadline=None)  # how long an example takes is the machine's affair
settings.load_profile("untimed")


class _ByFile(LoadFileScheduling):  # type: ignore[misc]
    """Shares the tests out by file, where several processes run them; all tests of containers go to one of them."""

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "containers" if "compose/" in file else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling:
    return _ByFile(config, log)


@pytest.fixture
def upstream() -> Iterator[FakeUpstream]:
    """Detector, registrar and gateway, fake and well."""
    with FakeUpstream() as fakes:
        yield fakes


@pytest.fixture(scope="session")
def postgresql() -> Iterator[PostgresqlServer]:
    """A real server, for all tests that do not stop it."""
    try:
        server = PostgresqlServer()
    except (ImportError, OSError, subprocess.SubprocessError) as error:
        pytest.skip(f"PostgreSQL cannot be started here: {error}")
    with server:
        yield server


@pytest.fixture(params=KINDS)
def store_address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty store of each kind, as `PRETOUCH_ORCHESTRATOR_STORE` names it."""
    if request.param == "sqlite":
        return f"sqlite:{tmp_path / 'state'}"
    server: PostgresqlServer = request.getfixturevalue("postgresql")
    return server.new_database()
