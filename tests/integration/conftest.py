"""One real orchestrator before fake upstream services, for all tests that do not need one of their own.

A test may stop or kill either, as long as it starts it again.
"""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator


@pytest.fixture(scope="session")
def fakes() -> Iterator[FakeUpstream]:
    with FakeUpstream() as upstream:
        yield upstream


@pytest.fixture(scope="session")
def orchestrator(tmp_path_factory: pytest.TempPathFactory, fakes: FakeUpstream) -> Iterator[Orchestrator]:
    with Orchestrator(tmp_path_factory.mktemp("state"), fakes.address) as process:
        yield process


@pytest.fixture(scope="session")
def rest(orchestrator: Orchestrator) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=orchestrator.rest_url, timeout=60) as client:
        yield client
