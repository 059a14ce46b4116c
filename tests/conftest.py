"""Fixtures that several suites share. This file also puts `tests/` on the path, so that `helpers` can be imported."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers.fake_upstream import FakeUpstream
from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # how long an example takes is the machine's affair
settings.load_profile("untimed")


@pytest.fixture
def upstream() -> Iterator[FakeUpstream]:
    """Detector, registrar and gateway, fake and well."""
    with FakeUpstream() as fakes:
        yield fakes
