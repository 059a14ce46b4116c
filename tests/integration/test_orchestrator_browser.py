"""REST and browsers: foreign names and pages are refused, a token is entered once, and HEAD is GET without a body."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from helpers import box_view
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator
from helpers.rest_sessions import assert_problem, opened
from pretouch_orchestrator.rest.hosts import HostCheck

TOKEN = "s3cret;with=odd,signs%20"
PAGE = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}


@pytest.fixture(scope="module")
def guarded(fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Orchestrator]:
    with Orchestrator(tmp_path_factory.mktemp("guarded"), fakes.address, PRETOUCH_TOKEN=TOKEN) as process:
        yield process


@pytest.fixture
def browser(guarded: Orchestrator) -> Iterator[httpx.Client]:
    """Keeps cookies, as a browser does; redirections are followed by hand."""
    with httpx.Client(base_url=guarded.rest_url, timeout=60, trust_env=False) as client:
        yield client


def log_in(browser: httpx.Client, guarded: Orchestrator, target: str = "/docs", token: str = TOKEN) -> httpx.Response:
    return browser.post("/login", data={"token": token, "next": target}, headers={"Origin": guarded.rest_url})


def test_a_browser_logs_in_once_and_then_sees_every_page(browser: httpx.Client, guarded: Orchestrator) -> None:
    sent = browser.get("/docs?x=1", headers=PAGE)
    assert (sent.status_code, sent.headers["location"]) == (303, "/login?next=%2Fdocs%3Fx%3D1")
    form = browser.get(sent.headers["location"], headers=PAGE)
    assert form.status_code == 200
    assert 'value="/docs?x=1"' in form.text.replace("'", '"')
    assert "frame-ancestors 'none'" in form.headers["content-security-policy"]
    done = log_in(browser, guarded, "/docs?x=1")
    assert (done.status_code, done.headers["location"]) == (303, "/docs?x=1")
    cookie = done.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    for path in ("/docs", "/openapi.json", "/metrics", "/v1/sessions"):
        assert browser.get(path, headers=PAGE).status_code == 200
    out = browser.post("/logout", headers={"Origin": guarded.rest_url})
    assert out.status_code == 303
    assert_problem(browser.get("/v1/sessions"), 401, "no token")


def test_a_wrong_token_is_said_in_the_form_and_no_redirection_leaves(
    browser: httpx.Client, guarded: Orchestrator
) -> None:
    wrong = log_in(browser, guarded, token="guess")
    assert wrong.status_code == 401
    assert "wrong" in wrong.text
    assert "set-cookie" not in wrong.headers
    for target in ("//evil.example/", "https://evil.example/", "/\\evil.example", "javascript:alert(1)", "/a\r\nb: c"):
        done = log_in(browser, guarded, target)
        assert (done.status_code, done.headers["location"]) == (303, "/")
    form = browser.get("/login", params={"next": "'><script>alert(1)</script>"}).text
    assert "<script>" not in form
    assert browser.post("/login", content=b"x" * 200_000, headers={"Origin": guarded.rest_url}).status_code == 401


def test_a_cookie_changes_nothing_unless_its_own_page_asks(browser: httpx.Client, guarded: Orchestrator) -> None:
    log_in(browser, guarded)
    for headers, status in (
        ({}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": guarded.rest_url}, 201),
        ({"Authorization": f"Bearer {TOKEN}"}, 201),
    ):
        answer = browser.post("/v1/sessions", files=box_view.multipart(), headers=headers)
        assert answer.status_code == status, answer.text


@pytest.mark.parametrize("path", ["/healthz", "/v1/sessions", "/docs", "/nowhere"])
def test_a_foreign_name_is_refused_and_an_address_is_not(path: str, rest: httpx.Client) -> None:
    port = rest.base_url.port
    for host in (
        "evil.example",
        f"evil.example:{port}",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "a@b",
        "]",
    ):
        assert_problem(rest.get(path, headers={"Host": host}), 403, "ALLOWED_HOSTS")
    own = (
        f"127.0.0.1:{port}",
        "localhost",
        f"LOCALHOST:{port}",
        "localhost.",
        "[::1]:1",
        "192.168.1.5",
        socket.gethostname(),
    )
    for host in own:
        assert rest.get(path, headers={"Host": host}).status_code in (200, 404)


def test_a_page_of_another_site_cannot_post(rest: httpx.Client) -> None:
    port = rest.base_url.port
    for origin in (
        "http://evil.example",
        "null",
        "http://127.0.0.1:1",
        f"http://192.168.1.5:{port}",
        "x",
        "http://[::1",
    ):
        refused = rest.post("/v1/sessions", files=box_view.multipart(), headers={"Origin": origin})
        assert_problem(refused, 403, "page")
    own = rest.post("/v1/sessions", files=box_view.multipart(), headers={"Origin": f"http://127.0.0.1:{port}"})
    assert own.status_code == 201


@pytest.mark.parametrize(
    ("bound", "allowed", "host", "passes"),
    [
        ("0.0.0.0", (), "robot-cell:8080", True),
        ("0.0.0.0", (), "robot-cell.local", True),
        ("0.0.0.0", (), "orchestrator.pretouch.svc.cluster.local:8080", True),
        ("0.0.0.0", (), "evil.example", False),
        ("127.0.0.1", (), "robot-cell", False),
        ("cell.factory.example", (), "cell.factory.example:8080", True),
        ("0.0.0.0", ("cell.factory.example",), "CELL.factory.example", True),
        ("0.0.0.0", ("cell.factory.example",), "evil.example", False),
        ("0.0.0.0", ("*",), "evil.example", True),
    ],
)
def test_which_names_are_allowed(bound: str, allowed: tuple[str, ...], host: str, passes: bool) -> None:
    scope = {"headers": [(b"host", host.encode())]}
    assert (HostCheck(bound, allowed).find_refusal(scope) is None) is passes


def test_a_listed_page_of_another_site_may_call(tmp_path: Path, fakes: FakeUpstream) -> None:
    variables = {"PRETOUCH_ORCHESTRATOR_ALLOWED_HOSTS": "dash.example, robots.example", "PRETOUCH_OPEN_METRICS": "1"}
    with (
        Orchestrator(tmp_path, fakes.address, PRETOUCH_TOKEN=TOKEN, **variables) as orchestrator,
        httpx.Client(base_url=orchestrator.rest_url, timeout=60, trust_env=False) as client,
    ):
        headers = {"Host": "robots.example", "Origin": "https://dash.example", "Authorization": f"bearer {TOKEN}"}
        assert client.get("/v1/sessions", headers=headers).status_code == 200
        assert "pretouch_orchestrator" in client.get("/metrics").text
        assert client.get("/v1/sessions").status_code == 401


def test_head_is_get_without_a_body(rest: httpx.Client) -> None:
    session = opened(rest)["id"]
    paths = ["/", "/healthz", "/readyz", "/metrics", "/docs", "/openapi.json", "/v1/sessions", "/v1/caller", "/nowhere"]
    paths += [f"/v1/sessions/{session}", f"/v1/sessions/{session}/next-scan", "/v1/sessions/none"]
    for path in paths:
        head, get = rest.head(path), rest.get(path)
        assert (head.status_code, head.content) == (get.status_code, b""), path
        length = {} if path == "/metrics" else {"content-length": get.headers["content-length"]}
        expected = {"content-type": get.headers["content-type"]} | length
        assert {name: head.headers.get(name) for name in expected} == expected, path
    stream = rest.head(f"/v1/sessions/{session}/events")
    assert stream.status_code == 200
    assert stream.headers["content-type"].startswith("text/event-stream")
    assert rest.get("/healthz").status_code == 200  # over the same connection


@pytest.mark.parametrize("name", ["%00", "a%00b", "%ff", "%2e%2e%2fhealthz", "a%0d%0ab", "%F0%9F%A4%96", "x" * 5000])
def test_odd_names_of_sessions_are_not_found(name: str, rest: httpx.Client) -> None:
    for path in (f"/v1/sessions/{name}", f"/v1/sessions/{name}/events"):
        assert_problem(rest.get(path), 404)
    assert_problem(rest.post(f"/v1/sessions/{name}/scans/{name}", json={"points": [[0, 0, 0]]}), 404)
    assert rest.delete(f"/v1/sessions/{name}").status_code in (404, 405)
