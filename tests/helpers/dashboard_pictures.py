"""Takes the pictures of the dashboard that the documentation shows: cd tests && python -m helpers.dashboard_pictures"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image

from helpers.chromium import browsing
from helpers.simulated_cell import SimulatedCell

FOLDER = Path(__file__).parents[2] / "docs" / "how-to"
COLOURS = 255
WIDE, NARROW = {"width": 1180, "height": 980}, {"width": 390, "height": 1100}


def take(page: Any, name: str) -> None:
    """A picture of the page, with few colours, so that it is small."""
    path = FOLDER / f"{name}.png"
    page.evaluate("document.activeElement.blur()")
    page.screenshot(path=path, animations="disabled")
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> None:
    with SimulatedCell("mug") as mug, browsing() as browser, browser.page(base_url=mug.rest, viewport=WIDE) as fingers:
        for tolerance, scans in ((0.012, 10), (0.004, 2), (0.006, 10)):
            *_, last = mug.session(tolerance, scans)
        going_on = mug.session(0.003)
        for _ in range(4):
            last = next(going_on)
        assert last.next_scan is not None
        fingers.goto("/#/devices")
        fingers.wait_for_selector("svg.chart")
        for _ in range(5):
            mug.move(last.next_scan)
        take(fingers, "dashboard-fingertips")
        views = (("", "light", WIDE), ("-dark", "dark", WIDE), ("-narrow", "light", NARROW))
        for suffix, scheme, size in views:
            with browser.page(base_url=mug.rest, viewport=size, color_scheme=scheme) as page:
                page.goto("/")
                page.wait_for_selector("tbody tr")
                page.wait_for_selector("#health .badge")
                take(page, f"dashboard{suffix}")
                page.goto(f"/#/sessions/{last.id}")
                page.wait_for_selector("canvas")
                take(page, f"dashboard-session{suffix}")
        going_on.close()
        assert not browser.faults, browser.faults


if __name__ == "__main__":
    main()
