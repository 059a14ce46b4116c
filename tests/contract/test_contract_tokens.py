"""What each token allows, over both wires: roles, and tokens that come and go while the service runs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from helpers.box_session import DEPTH, MASK, TOKEN, request
from helpers.client_kinds import KINDS, opened
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator

from pretouch.client import RestClient
from pretouch.errors import Forbidden, NotFound, Unauthenticated
from pretouch.serving.tokens import make_token
from pretouch.session import Skipped

WITHIN = 30  # s in which a changed file is noticed


class Shop:
    """An orchestrator with a file of tokens, and TOKEN for itself."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tokens.toml"
        self.full, self._full_entry = make_token("line-1")
        self.read, read_entry = make_token("line-1", "read")
        self.write(self._full_entry, read_entry)
        self.entries = (self._full_entry, read_entry)
        self.orchestrator: Orchestrator

    def write(self, *entries: str) -> None:
        self.path.write_text("".join(entries))
        self.path.chmod(0o600)

    @asynccontextmanager
    async def client(self, kind: str, token: str) -> AsyncIterator[Any]:
        async with opened(kind, self.orchestrator.rest_url, self.orchestrator.address, token=token) as client:
            yield client


@pytest.fixture(scope="module")
def shop(fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("shop")
    made = Shop(folder)
    variables = {"PRETOUCH_TOKENS_FILE": str(made.path), "PRETOUCH_TOKEN": TOKEN}
    with Orchestrator(folder / "state", fakes.address, **variables) as made.orchestrator:
        yield made


@pytest.mark.parametrize("what", ["report", "recording.mcap"])
async def test_what_is_downloaded_is_for_its_owners_tokens_that_only_read_too(what: str, shop: Shop) -> None:
    async with shop.client("rest", shop.full) as owner:
        session = await owner.create_session(request(), DEPTH, MASK)
    answers = {}
    async with httpx.AsyncClient(base_url=shop.orchestrator.rest_url, timeout=WITHIN) as rest:
        for token in (shop.full, shop.read, TOKEN):
            headers = {"Authorization": f"Bearer {token}"}
            answers[token] = (await rest.get(f"/v1/sessions/{session.id}/{what}", headers=headers)).status_code
    assert answers == {shop.full: 200, shop.read: 200, TOKEN: 404}


@pytest.mark.parametrize("kind", KINDS)
async def test_a_token_for_reading_reads_and_changes_nothing(kind: str, shop: Shop) -> None:
    async with shop.client(kind, shop.full) as owner, shop.client(kind, shop.read) as reader:
        session = await owner.create_session(request(), DEPTH, MASK)
        assert session.next_scan is not None
        scan = session.next_scan.scan_id
        for change in (
            lambda: reader.create_session(request(), DEPTH, MASK),
            lambda: reader.cancel(session.id),
            lambda: reader.submit(session.id, scan, Skipped()),
            lambda: reader.forget_camera("head"),
        ):
            with pytest.raises(Forbidden, match="only read") as caught:
                await change()
            assert caught.value.remedy
        assert (await reader.session(session.id)).state is session.state
        assert session.id in [each.id async for each in reader.all_sessions()]
        await owner.cancel(session.id)
        assert [event.type async for event in reader.events(session.id)][-1] == "end"


@pytest.mark.parametrize("kind", KINDS)
async def test_cameras_are_of_their_owner(kind: str, shop: Shop) -> None:
    camera = f"head-{kind}"
    async with shop.client(kind, shop.full) as owner, shop.client(kind, shop.read) as reader:
        await owner.create_session(request(camera_id=camera), DEPTH, MASK)
        assert (await reader.camera(camera)).id == camera
        assert camera in [each.id for each in await reader.cameras()]
        async with shop.client(kind, TOKEN) as stranger:
            assert camera not in [each.id for each in await stranger.cameras()]
            for call in (stranger.camera(camera), stranger.forget_camera(camera)):
                with pytest.raises(NotFound):
                    await call
        await owner.forget_camera(camera)


async def test_tokens_come_and_go_without_a_restart(shop: Shop) -> None:
    new, entry = make_token("line-1")

    async def accepted(kind: str, token: str) -> bool:
        async with shop.client(kind, token) as client:
            try:
                await client.sessions()
            except Unauthenticated:
                return False
            return True

    for kind in ("rest-async", "grpc-async"):
        assert not await accepted(kind, new)
    shop.write(*shop.entries, entry)
    await eventually(lambda: accepted("rest-async", new))
    assert await accepted("grpc-async", new)
    assert await accepted("grpc-async", shop.full)
    shop.write(*shop.entries)
    await eventually(lambda: rejected(accepted("grpc-async", new)))
    assert not await accepted("rest-async", new)
    for kind in ("rest-async", "grpc-async"):
        assert await accepted(kind, TOKEN)


async def rejected(answer: Awaitable[bool]) -> bool:
    return not await answer


async def eventually(holds: Callable[[], Awaitable[bool]]) -> None:
    """Returns once `holds()`: the service looks at the file every second, and tells nobody."""
    for _ in range(2 * WITHIN):
        if await holds():
            return
        await asyncio.sleep(0.5)
    raise AssertionError("it never came to hold")


def test_wrong_tokens_are_slowed_down_and_the_right_one_is_taken(shop: Shop) -> None:
    url = f"{shop.orchestrator.rest_url}/v1/sessions"
    with httpx.Client(trust_env=False, timeout=60) as client:
        answers = [client.get(url, headers={"Authorization": f"Bearer guess-{k}"}) for k in range(30)]
        statuses = [answer.status_code for answer in answers]
        assert set(statuses) == {401, 429}
        assert statuses.index(429) <= 20
        late = answers[statuses.index(429)]
        assert int(late.headers["retry-after"]) >= 1
        assert late.json()["type"].endswith("too-many-tries")
        assert client.get(url, headers={"Authorization": f"bEaReR {shop.full}"}).status_code == 200
    with RestClient(shop.orchestrator.rest_url, token=shop.full) as friend:
        friend.sessions()
