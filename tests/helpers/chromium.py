"""Debian's Chromium, driven by Playwright: pages whose faults are noted, and what axe-core finds on them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium")
_HTTP_STATUS = "Failed to load resource"
"""What the console says of any answer that is no success, such as the 404 of a view that is not there."""
_IMPACTS = ("serious", "critical")


@dataclass
class Browser:
    """A browser; `faults` are errors of scripts, of the console and of the content security policy, of all pages."""

    chromium: Any
    faults: list[str] = field(default_factory=list)

    @contextmanager
    def page(self, **options: Any) -> Iterator[Any]:
        """A page in a context of its own, with the options of Playwright's `new_context`."""
        context = self.chromium.new_context(**{"accept_downloads": True, **options})
        context.on("page", self._watch)
        try:
            yield context.new_page()
        finally:
            context.close()

    def _watch(self, page: Any) -> None:
        page.on("pageerror", lambda error: self.faults.append(f"{page.url}: {error}"))
        page.on("console", lambda message: self._note(page, message))

    def _note(self, page: Any, message: Any) -> None:
        offline = "net::ERR_" in message.text  # the orchestrator is being restarted
        if message.type == "error" and not message.text.startswith(_HTTP_STATUS) and not offline:
            self.faults.append(f"{page.url}: {message.text}")


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser; the test is skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=os.geteuid() != 0)
        try:
            yield Browser(chromium)
        finally:
            chromium.close()


def find_barriers(page: Any) -> list[str]:
    """The serious and critical faults that axe-core finds on the page as it is."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed")
    found = axe.Axe().run(page).response["violations"]
    return [
        f"{each['id']}: {each['help']}: {[node['html'][:200] for node in each['nodes'][:3]]}"
        for each in found
        if each["impact"] in _IMPACTS
    ]
