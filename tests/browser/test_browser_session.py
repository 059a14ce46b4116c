"""A session of real services and a simulated robot, while the dashboard is open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.chromium import Browser
from helpers.simulated_cell import SimulatedCell

expect = pytest.importorskip("playwright.sync_api", reason="playwright is not installed").expect
pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def cell(browser: Browser) -> Iterator[SimulatedCell]:
    with SimulatedCell("drill") as running:
        yield running


def test_a_session_appears_grows_and_ends_and_its_report_stays(
    browser: Browser, cell: SimulatedCell, tmp_path: Path
) -> None:
    with browser.page(base_url=cell.rest) as page:
        page.goto("/")
        expect(page.get_by_text("There is no session yet")).to_be_visible()
        steps = cell.session()
        session = next(steps)
        link = page.get_by_role("link", name=session.id)
        expect(link).to_be_visible()
        expect(page.get_by_role("row", name=session.id)).to_contain_text("Under way")
        other = page.context.new_page()  # a second tab keeps the list
        other.goto("/")
        link.click()
        expect(page.get_by_role("heading", level=1)).to_have_text(f"Session {session.id}")
        expect(page.get_by_text("Under way without a scan.")).to_be_visible()
        rows = page.get_by_role("region", name="Scans", exact=True).locator("tbody tr")
        expect(rows).to_have_count(1)

        slider = page.locator("[data-view=scene] input[type=range]")
        canvas = page.locator("canvas")
        canvas.focus()
        turned = _picture(canvas)
        canvas.press("ArrowLeft")
        assert _picture(canvas) != turned
        for count, latest in enumerate(steps, start=1):
            session = latest
            expect(rows).to_have_count(count + 1)
            assert slider.evaluate("each => each.max") == str(count)
            expect(canvas).to_be_focused()
        assert session.state.ended
        word = session.state.value.capitalize()
        expect(page.locator(".badge").filter(has_text=word).first).to_be_visible()
        expect(other.get_by_role("row", name=session.id)).to_contain_text(word)
        expect(page.get_by_role("button", name="Cancel the session")).to_have_count(0)

        with page.expect_download() as downloading:
            page.get_by_role("link", name="Download the report").click()
        report = tmp_path / "report.html"
        downloading.value.save_as(report)
        assert report.stat().st_size < 3e6
        with browser.page(offline=True) as reader:
            reader.goto(report.as_uri())
            expect(reader.get_by_role("heading", level=1)).to_have_text(f"Session {session.id}")
            expect(reader.locator("svg.chart")).to_have_count(2)
            assert _is_drawn(reader.locator("canvas"))
        assert page.get_by_role("link", name="Recording").get_attribute("href") == (
            f"/v1/sessions/{session.id}/recording.mcap"
        )


def test_ranges_of_a_real_gateway_are_drawn_as_they_come(browser: Browser, cell: SimulatedCell) -> None:
    with browser.page(base_url=cell.rest) as page:
        page.goto("/#/devices")
        expect(page.get_by_role("row", name="finger streaming")).to_contain_text("streaming")
        expect(page.locator(".values")).to_have_text("Now: no target")
        expect(page.locator("svg.chart")).to_be_visible()


def _picture(canvas: Any) -> str:
    return str(canvas.evaluate("each => each.toDataURL()"))


def _is_drawn(canvas: Any) -> bool:
    """Whether anything but the background is on it."""
    return bool(
        canvas.evaluate("each => each.getContext('2d').getImageData(0, 0, each.width, each.height).data.some((v) => v)")
    )
