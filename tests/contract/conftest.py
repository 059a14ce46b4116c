"""One real orchestrator process with fake services behind it, for all contract tests."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.box_session import TOKEN
from helpers.client_kinds import KINDS, opened
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator


@pytest.fixture(scope="session")
def fakes() -> Iterator[FakeUpstream]:
    with FakeUpstream() as upstream:
        yield upstream


@pytest.fixture(scope="session")
def orchestrator(fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Orchestrator]:
    with Orchestrator(tmp_path_factory.mktemp("state"), fakes.address) as service:
        yield service


@pytest.fixture(scope="session")
def guarded(fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Orchestrator]:
    """An orchestrator that wants TOKEN."""
    state: Path = tmp_path_factory.mktemp("guarded")
    with Orchestrator(state, fakes.address, PRETOUCH_TOKEN=TOKEN) as service:
        yield service


@pytest.fixture(params=KINDS)
async def client(request: pytest.FixtureRequest, orchestrator: Orchestrator) -> AsyncIterator[Any]:
    """Each of the four clients."""
    async with opened(request.param, orchestrator.rest_url, orchestrator.address) as opened_client:
        yield opened_client
