"""REST requests that schemathesis makes from the OpenAPI document, and the same with sessions and images that exist."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import hypothesis
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import GenerationMode
from schemathesis.checks import CHECKS, load_all_checks, response_schema_conformance
from schemathesis.transport.serialization import Binary

from fuzz.apis.counts import Counts
from fuzz.apis.seeds import DEVICE, OpenSession, find, small_request
from pretouch.client import RestClient
from pretouch.client.images import encode_depth, encode_mask
from pretouch.errors import PretouchError
from pretouch.wire.json import request_to_json

_TIMEOUT = 60.0
_EXAMPLES = 15
Case = schemathesis.Case[Any]
load_all_checks()
schemathesis.serializer.alias("application/x-ndjson", "text/plain")
_LEFT_OUT = {"ignored_auth", "positive_data_acceptance", "negative_data_rejection", "missing_required_header"}
_CHECKS: list[Any] = [
    check for check in (CHECKS.get_one(name) for name in CHECKS.get_all_names()) if check.__name__ not in _LEFT_OUT
]


def fuzz_rest(url: str, counts: Counts, seed: int, over: Callable[[], bool]) -> None:
    """Sends requests until `over()`."""
    document = httpx.get(f"{url}/openapi.json", timeout=_TIMEOUT, trust_env=False).json()
    found: list[Any] = list(schemathesis.openapi.from_dict(document).get_all_operations())
    with RestClient(url, timeout=120.0) as client:
        send = _Sender(url, counts, client, over)
        turn = seed * 100_000
        while not over():
            for operation in found:
                for mode in GenerationMode:
                    turn += 1
                    _explore(operation.ok(), mode, turn, send)


class _Sender:
    """Sends a case as it is, then with a session and images that exist, so that it gets further."""

    def __init__(self, url: str, counts: Counts, client: RestClient, over: Callable[[], bool]) -> None:
        self._url, self._counts, self._client, self._over = url, counts, client, over
        self._sessions = OpenSession(client)
        self._ended = ""

    def __call__(self, case: Case) -> None:
        if self._over():
            return
        self._send(case)
        try:
            fits = self._make_fit(case)
        except PretouchError as error:
            self._counts.fault(f"a good session: {type(error).__name__}: {error}")
            return
        if fits:
            self._send(case)

    def _make_fit(self, case: Case) -> bool:
        if "scan_id" in case.path_parameters:
            session, plan = self._sessions.get()
            case.path_parameters |= {"session_id": session.id, "scan_id": plan.scan_id}
        elif "session_id" in case.path_parameters:
            case.path_parameters["session_id"] = self._find_ended()
        elif "name" in case.path_parameters and not case.path.endswith("/ranges"):  # which has no end
            case.path_parameters["name"] = DEVICE
        elif isinstance(case.body, dict) and "depth" in case.body:
            asked, depth, mask = small_request()
            case.body["depth"], case.body["mask"] = Binary(encode_depth(depth)[0]), Binary(encode_mask(mask)[0])
            case.body["request"] = request_to_json(asked) | _choose_member(case.body.get("request"))
        else:
            return False
        return True

    def _find_ended(self) -> str:
        """A session whose events come to an end."""
        if find(self._client, self._ended) is None:
            self._ended = self._client.create_session(*small_request()).id
            self._client.cancel(self._ended)
        return self._ended

    def _send(self, case: Case) -> None:
        name = f"REST {case.method} {case.path}"
        self._counts.send(name)
        try:
            response = case.call(base_url=self._url, timeout=_TIMEOUT)
        except requests.RequestException as error:
            self._counts.answer(name, type(error).__name__)
            self._counts.fault(f"{name} had no answer: {error!s:.160}")
            return
        self._counts.answer(name, str(response.status_code))
        if response.status_code >= 500 and response.status_code not in (503, 504):
            self._counts.fault(f"{name} answered {response.status_code}: {response.text:.160}")
        stream = response.headers.get("content-type", [""])[0].startswith("text/event-stream")
        try:
            case.validate_response(
                response, checks=_CHECKS, excluded_checks=[response_schema_conformance] if stream else []
            )
        except (AssertionError, BaseExceptionGroup) as error:
            self._counts.fault(f"{name} answered {response.status_code} not as described: {_first_of(error)}")


def _choose_member(made: Any) -> dict[str, Any]:
    """One member of a request that schemathesis made, another one for every request."""
    if not isinstance(made, dict) or not made:
        return {}
    name = sorted(made, key=str)[hash(str(made)) % len(made)]
    return {name: made[name]}


def _first_of(error: BaseException) -> str:
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return " ".join(str(error).split())[:160]


def _explore(operation: Any, mode: GenerationMode, turn: int, send: _Sender) -> None:
    @hypothesis.seed(turn)
    @settings(
        max_examples=_EXAMPLES,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def explore(case: Case) -> None:
        send(case)

    try:
        explore()
    except hypothesis.errors.Unsatisfiable:  # such as a wrong request to an operation that takes nothing
        return
