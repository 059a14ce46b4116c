"""One browser for all tests, and an orchestrator before fake upstream services for those that need no real scan.

A test fails with what its pages reported: errors of scripts, and of the content security policy.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from helpers.chromium import Browser, browsing
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Closed with its module: while Playwright's synchronous API is open, no asyncio test can run in the process."""
    with browsing() as found:
        yield found


@pytest.fixture(scope="module")
def fakes() -> Iterator[FakeUpstream]:
    with FakeUpstream() as upstream:
        yield upstream


@pytest.fixture(scope="module")
def orchestrator(
    browser: Browser, tmp_path_factory: pytest.TempPathFactory, fakes: FakeUpstream
) -> Iterator[Orchestrator]:
    with Orchestrator(tmp_path_factory.mktemp("state"), fakes.address) as process:
        yield process


@pytest.fixture
def rest(orchestrator: Orchestrator) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=orchestrator.rest_url, timeout=60, trust_env=False) as client:
        yield client


@pytest.fixture
def page(browser: Browser, orchestrator: Orchestrator) -> Iterator[Any]:
    """A page for the orchestrator; paths are enough."""
    with browser.page(base_url=orchestrator.rest_url) as opened:
        yield opened


@pytest.fixture(autouse=True)
def no_faults(browser: Browser) -> Iterator[None]:
    browser.faults.clear()
    yield
    assert not browser.faults
