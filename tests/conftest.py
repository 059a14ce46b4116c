"""Fixtures that several suites share. This file also puts `tests/` on the path, so that `helpers` can be imported."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.fake_upstream import FakeUpstream
from helpers.postgresql import PostgresqlServer
from helpers.stores import KINDS
from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # how long an example takes is the machine's affair
settings.load_profile("untimed")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where several processes share the tests, each file's run in one of them, and so do those of all containers."""
    for item in items:
        alone = item.path.parent.name == "compose"
        item.add_marker(pytest.mark.xdist_group("containers" if alone else item.path.stem))


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
