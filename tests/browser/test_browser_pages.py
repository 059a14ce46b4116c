"""The dashboard: markup in names, tokens, restarts, faults of services, the keyboard, narrow screens, and axe-core."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from helpers.chromium import Browser, find_barriers
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import opened, scanned
from pretouch_orchestrator.report.page import render_page

from pretouch.serving.tokens import make_token

expect = pytest.importorskip("playwright.sync_api", reason="playwright is not installed").expect
HOSTILE = "<img src=x onerror=alert(1)><script>alert(2)</script>\"'&"
IDENTITY = {"translation": [0.003, 0.004, 0.0], "rotation": [0.0, 0.0, 0.0087265, 0.99996]}
CAMERAS = [
    {
        "id": name,
        "sessions": 6,
        "base_T_camera": IDENTITY,
        "camera_T_camera": IDENTITY,
        "base_T_base": IDENTITY,
        "covariance": [0.0] * 144,
        "residual": {"translation_std": 0.0012, "rotation_std": 0.002},
        "drift": {"state": state, "since": "s4" if state == "moved" else None},
        "history": [
            {"session": f"s{k}", "at": 1.7e9 + k, "error": e, "expected_error": p}
            for k, (e, p) in enumerate(
                [(0.012, 0.018), (0.012, 0.004), (0.011, 0.002), (0.021, 0.002), (0.02, 0.018)], 1
            )
        ],
    }
    for name, state in (("head", "steady"), ("wrist", "moved"))
]


@pytest.fixture
def session(rest: httpx.Client) -> dict[str, Any]:
    """Under way, with one scan."""
    return scanned(rest, opened(rest))


def answering(page: Any, pattern: str, change: Callable[[Any], Any]) -> None:
    """Answers of these addresses are changed on their way to the page."""

    def handle(route: Any) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=change(answer.json()))

    page.route(pattern, handle)


def with_cameras(page: Any) -> None:
    """As an orchestrator answers that learns of cameras."""
    documents = {"": {"cameras": CAMERAS}} | {f"/{camera['id']}": camera for camera in CAMERAS}
    page.route(
        "**/v1/cameras**", lambda route: route.fulfill(json=documents[route.request.url.partition("/cameras")[2]])
    )


def test_markup_in_names_and_texts_is_text(page: Any, session: dict[str, Any]) -> None:
    dialogs: list[str] = []
    page.on("dialog", lambda dialog: (dialogs.append(dialog.message), dialog.dismiss()))

    def spoil(document: Any) -> Any:
        """All of its texts but those that the page must understand."""
        if isinstance(document, dict):
            return {k: v if k in ("state", "data", "created") else spoil(v) for k, v in document.items()}
        if isinstance(document, list):
            return [spoil(each) for each in document]
        return HOSTILE if isinstance(document, str) else document

    warning = {"code": "x", "detail": "y", "remedy": "z"}
    answering(page, "**/v1/sessions?*", spoil)
    answering(page, "**/report?format=json", lambda found: spoil({**found, "warnings": [warning]}))
    answering(page, "**/v1/devices", spoil)
    answering(page, "**/v1/services", spoil)
    for path, shown in (
        ("/#/sessions", "tbody th"),
        (f"/#/sessions/{session['id']}", ".warning"),
        (f"/#/sessions/{HOSTILE.replace('%', '%25').replace('/', '%2F')}", "h1"),
        ("/#/devices", "tbody th"),
        ("/#/services", "tbody th"),
    ):
        page.goto("about:blank")
        page.goto(path)
        expect(page.locator(shown).first).to_contain_text(HOSTILE)
        assert page.locator("img[src=x], main script").count() == 0
    assert dialogs == []


def test_a_browser_cannot_be_made_to_run_markup(page: Any, browser: Browser) -> None:
    page.goto("/")
    injected = (
        "() => { try { document.body.innerHTML = '<b>x</b>'; return 'done'; } catch (error) { return error.name; } }"
    )
    assert page.evaluate(injected) == "TypeError"
    assert all("TrustedHTML" in fault for fault in browser.faults)
    browser.faults.clear()


def test_pages_of_a_long_list_follow_each_other(page: Any, rest: httpx.Client) -> None:
    ids = [opened(rest)["id"] for _ in range(4)][::-1]
    asked: list[str] = []

    def ask_for_fewer(route: Any) -> None:
        asked.append(route.request.url)
        route.continue_(url=route.request.url.replace("limit=25", "limit=3"))

    page.route("**/v1/sessions?*", ask_for_fewer)
    page.goto("/")
    rows = page.locator("tbody tr")
    expect(rows).to_have_count(3)
    assert [each.get_attribute("data-key") for each in rows.all()] == ids[:3]
    page.get_by_role("link", name="Older").click()
    expect(rows.first).to_have_attribute("data-key", ids[3])
    page.get_by_role("link", name="Newest").click()
    expect(rows.first).to_have_attribute("data-key", ids[0])
    assert all("limit=25" in url for url in asked)


def test_a_session_is_cancelled_and_removed_only_once_confirmed(
    page: Any, session: dict[str, Any], rest: httpx.Client
) -> None:
    path = f"/v1/sessions/{session['id']}"
    page.goto(f"/#/sessions/{session['id']}")
    cancel = page.get_by_role("button", name="Cancel the session …")
    cancel.click()
    expect(page.get_by_role("dialog")).to_contain_text(session["id"])
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(cancel).to_be_focused()
    assert rest.get(path).json()["state"] == "awaiting_scan"
    cancel.press("Enter")
    page.get_by_role("button", name="Cancel the session", exact=True).click()
    expect(page.locator(".badge").filter(has_text="Cancelled")).to_be_visible()
    expect(page.locator("#announcer")).to_contain_text("Cancelled")
    assert rest.get(path).json()["state"] == "cancelled"
    expect(cancel).to_have_count(0)
    page.get_by_role("button", name="Remove it …").click()
    page.get_by_role("button", name="Remove it for good").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Sessions")
    assert rest.get(path).status_code == 404
    page.goto(f"/#/sessions/{session['id']}")
    expect(page.get_by_role("alert")).to_contain_text("There is no session")


@pytest.fixture(scope="module")
def guarded(
    browser: Browser, fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, dict[str, str]]]:
    """The URL of an orchestrator with tokens, and they by role; both of one owner."""
    folder = tmp_path_factory.mktemp("guarded")
    tokens = {role: make_token("cell", role) for role in ("full", "read")}
    (folder / "tokens.toml").write_text("\n".join(entry for _, entry in tokens.values()))
    with Orchestrator(folder / "state", fakes.address, PRETOUCH_TOKENS_FILE=str(folder / "tokens.toml")) as process:
        yield process.rest_url, {role: token for role, (token, _) in tokens.items()}


@pytest.mark.parametrize("role", ["full", "read"])
def test_a_token_is_asked_for_once_and_decides_what_may_be_done(
    browser: Browser, guarded: tuple[str, dict[str, str]], role: str
) -> None:
    url, tokens = guarded
    with httpx.Client(base_url=url, timeout=60, headers={"Authorization": f"Bearer {tokens['full']}"}) as rest:
        session = opened(rest)
    with browser.page(base_url=url) as page:
        page.goto("/")
        assert find_barriers(page) == []
        page.get_by_label("Token").fill("wrong")
        page.get_by_role("button", name="Log in").click()
        expect(page.get_by_role("alert")).to_contain_text("wrong")
        page.get_by_label("Token").fill(tokens[role])
        page.get_by_role("button", name="Log in").click()
        page.get_by_role("link", name=session["id"]).click()
        expect(page.get_by_text("Under way without a scan.")).to_be_visible()
        buttons = page.get_by_role("button", name="…")
        expect(buttons).to_have_count(2 if role == "full" else 0)
        expect(page.get_by_text("Your token may only read")).to_have_count(0 if role == "full" else 1)
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_label("Token")).to_be_visible()
        page.goto(f"/#/sessions/{session['id']}")
        expect(page.get_by_label("Token")).to_be_visible()


def test_a_page_outlives_a_restart(
    page: Any, session: dict[str, Any], rest: httpx.Client, orchestrator: Orchestrator
) -> None:
    page.goto(f"/#/sessions/{session['id']}")
    rows = page.get_by_role("region", name="Scans", exact=True).locator("tbody tr")
    expect(rows).to_have_count(2)
    banner = page.locator("#banner")
    orchestrator.kill()
    expect(banner).to_have_text("Connection lost. Retrying …", timeout=30_000)
    orchestrator.start()
    expect(banner).to_have_text("Connected again.", timeout=30_000)
    scanned(rest, session)
    expect(rows).to_have_count(3, timeout=30_000)


def test_services_that_are_gone_are_named(page: Any, fakes: FakeUpstream) -> None:
    page.goto("/#/services")
    row = page.get_by_role("row", name="registrar")
    expect(row).to_contain_text("ready")
    fakes.stop()
    try:
        expect(row).to_contain_text("cannot be reached", timeout=30_000)
    finally:
        fakes.start()
    expect(row).to_contain_text("none", timeout=30_000)


def test_cameras_are_shown_where_the_orchestrator_has_them(page: Any) -> None:
    page.goto("/")
    expect(page.get_by_text("all services ready")).to_be_visible()
    with_cameras(page)
    page.reload()
    page.get_by_role("link", name="Cameras").click()
    expect(page.get_by_role("row", name="head")).to_contain_text("5.0 mm and 1.00°")
    page.get_by_role("link", name="wrist").click()
    expect(page.locator("svg.chart")).to_contain_text("moved")
    expect(page.get_by_role("link", name="s4")).to_be_visible()


def test_a_session_names_its_camera_and_the_report_draws_it(
    page: Any, rest: httpx.Client, session: dict[str, Any], tmp_path: Path
) -> None:
    wrist = CAMERAS[1]
    history = [*wrist["history"], {"session": session["id"], "at": 1.7e9 + 9, "error": 0.02, "expected_error": 0.01}]
    camera = {key: wrist[key] for key in ("id", "sessions", "drift")} | {"history": history}
    answering(page, "**/report?format=json", lambda found: found | {"camera": camera})
    page.goto(f"/#/sessions/{session['id']}")
    expect(page.get_by_role("link", name="wrist")).to_have_attribute("href", "#/cameras/wrist")
    document = rest.get(f"/v1/sessions/{session['id']}/report", params={"format": "json"}).json()
    report = tmp_path / "report.html"
    report.write_text(render_page("x", "", [("x", document | {"camera": camera})]), encoding="utf-8")
    page.goto(report.as_uri())
    expect(page.locator("[data-view=camera] .own")).to_have_count(1)
    expect(page.locator("[data-view=camera] svg")).to_contain_text("moved")


def test_the_keyboard_is_enough(page: Any, session: dict[str, Any]) -> None:
    page.goto("/")
    expect(page.get_by_role("link", name=session["id"])).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
    page.get_by_role("link", name=session["id"]).focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", level=1)).to_be_focused()
    page.go_back()
    expect(page.get_by_role("heading", level=1)).to_have_text("Sessions")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_has_a_serious_barrier(
    browser: Browser, orchestrator: Orchestrator, session: dict[str, Any], scheme: str
) -> None:
    with browser.page(
        base_url=orchestrator.rest_url, color_scheme=scheme, viewport={"width": 360, "height": 740}
    ) as page:
        with_cameras(page)
        one = f"/v1/sessions/{session['id']}"
        for path, shown in (
            ("/", "tbody tr"),
            (f"/#/sessions/{session['id']}", "svg.chart"),
            ("/#/devices", "svg.chart"),
            ("/#/services", "tbody tr"),
            ("/#/cameras", "tbody tr"),
            ("/#/cameras/wrist", "svg.chart"),
            ("/#/nowhere", "h1"),
            (f"{one}/report", "canvas"),
            ("/docs", "h1"),
        ):
            page.goto(path)
            expect(page.locator(shown).first).to_be_visible()
            assert find_barriers(page) == [], path
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), f"{path} scrolls sideways"


def test_what_is_served_is_listed_and_under_a_strict_policy(rest: httpx.Client) -> None:
    page = rest.get("/")
    policy = page.headers["content-security-policy"]
    assert "unsafe" not in policy
    assert "default-src 'none'" in policy
    for name in ("main.js", "views.js", "style.css"):
        assert rest.get(f"/dashboard/{name}").status_code == 200
        assert rest.get(f"/dashboard/{name}").headers["x-content-type-options"] == "nosniff"
    for name in ("__init__.py", "nothing.js", "..%2F..%2Freadiness.py"):
        assert rest.get(f"/dashboard/{name}").status_code == 404
    for path in ("/login", "/docs"):
        assert "unsafe" not in rest.get(path).headers["content-security-policy"]


def test_nothing_of_the_dashboard_is_loaded_from_elsewhere() -> None:
    folder = Path(__file__).parents[2] / "services" / "orchestrator" / "pretouch_orchestrator" / "dashboard"
    texts = {path.name: path.read_text() for path in folder.iterdir() if path.suffix in (".js", ".css", ".html")}
    assert len(texts) > 5
    assert [
        name for name, text in texts.items() if "//" in text.replace("// ", "").replace("http://www.w3.org", "")
    ] == []
    assert json.dumps(texts).count("innerHTML") == 0
