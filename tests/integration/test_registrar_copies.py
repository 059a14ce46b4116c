"""Several registrars behind one orchestrator: a scene is sent once, to its home, and to the next while that is away."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import grpc
import numpy as np
import pytest
from helpers.fake_upstream import FakeUpstream
from helpers.scenes import Box, World
from pretouch_orchestrator.upstream.addresses import Addresses
from pretouch_orchestrator.upstream.clients import RegistrarClient
from pretouch_orchestrator.upstream.connection import UpstreamConnection
from pretouch_orchestrator.upstream.copies import Copies
from pretouch_orchestrator.upstream.ring import rank_copies

from pretouch.channel import open_channel
from pretouch.errors import Overloaded, RefusedForSize, Unavailable
from pretouch.prior import Prior
from pretouch.tof import Scan, Sensor
from pretouch.v1 import registrar_pb2_grpc
from pretouch.wire.common import scene_from_proto

SCENES = [World((Box.standing((0.08 + 0.001 * k, 0.06, 0.05)),)).scene() for k in range(12)]
SCAN = Scan(np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, -1.0]]), np.array([0.05]))


@contextmanager
def registrars(count: int) -> Iterator[dict[str, FakeUpstream]]:
    fakes = [FakeUpstream() for _ in range(count)]
    for fake in fakes:
        fake.start()
    try:
        yield {fake.address: fake for fake in fakes}
    finally:
        for fake in fakes:
            fake.stop()


@asynccontextmanager
async def client_of(addresses: str) -> AsyncIterator[tuple[RegistrarClient, Copies]]:
    def connect(address: str) -> UpstreamConnection:
        channel = open_channel(address)
        return UpstreamConnection("registrar", address, channel, registrar_pb2_grpc.RegistrarServiceStub(channel))

    copies = Copies("registrar", Addresses.parse(addresses), connect)
    async with copies.opened():
        yield RegistrarClient(copies), copies


def sent(fake: FakeUpstream) -> list[bytes]:
    """The digests of the scenes that were sent whole."""
    return [scene_from_proto(call.request.scene).digest for call in fake.calls if call.request.HasField("scene")]


def asked(fake: FakeUpstream) -> set[bytes]:
    return {call.request.scene_digest for call in fake.calls if call.request.scene_digest}


async def test_each_scene_is_sent_once_and_all_its_calls_go_to_its_home() -> None:
    with registrars(3) as fakes:
        async with client_of(",".join(fakes)) as (client, _):
            for _ in range(3):
                for scene in SCENES:
                    await client.register(scene, [SCAN], Prior(), Sensor())
        homes = {address: [s.digest for s in SCENES if rank_copies(fakes, s.digest)[0] == address] for address in fakes}
        for address, fake in fakes.items():
            assert sorted(sent(fake)) == sorted(homes[address])
            assert asked(fake) == set(homes[address])


async def test_while_a_copy_is_away_the_next_takes_over_and_afterwards_its_scenes_come_back() -> None:
    with registrars(3) as fakes:
        async with client_of(",".join(fakes)) as (client, copies):
            for scene in SCENES:
                await client.register(scene, [SCAN], Prior(), Sensor())
            home = rank_copies(fakes, SCENES[0].digest)
            fakes[home[0]].stop()
            before = len(fakes[home[1]].calls)
            await client.register(SCENES[0], [SCAN], Prior(), Sensor())
            assert SCENES[0].digest in sent(fakes[home[1]])
            assert len(fakes[home[1]].calls) == before + 2
            await copies.check()
            fakes[home[0]].start()
            while not any(call.method == "Register" for call in fakes[home[0]].calls[-1:]) or copies.absent:
                await client.register(SCENES[0], [SCAN], Prior(), Sensor())
                await asyncio.sleep(0.02)
        assert len(sent(fakes[home[2]])) == len(set(sent(fakes[home[2]])))


async def test_without_any_copy_the_service_is_unavailable_and_says_when_to_ask_again() -> None:
    with registrars(2) as fakes:
        async with client_of(",".join(fakes)) as (client, copies):
            for fake in fakes.values():
                fake.stop()
            with pytest.raises(Unavailable) as caught:
                await client.register(SCENES[0], [SCAN], Prior(), Sensor())
            assert caught.value.retry_after
            with pytest.raises(Unavailable):
                await copies.check()


async def test_a_busy_home_is_asked_again_when_it_said_so_and_its_answer_is_passed_on() -> None:
    with registrars(2) as fakes:
        async with client_of(",".join(fakes)) as (client, _):
            home, other = (fakes[address] for address in rank_copies(fakes, SCENES[0].digest))
            home.fail("Register", Overloaded("busy", "wait", 30.0))
            with pytest.raises(Overloaded) as caught:
                await client.register(SCENES[0], [SCAN], Prior(), Sensor())
            assert caught.value.retry_after == 30.0
            assert len(home.calls) == 1
            assert not other.calls


async def test_a_copy_that_hangs_is_left_and_the_next_answers() -> None:
    """It takes connections and never answers, as a stopped process does."""
    with socket.create_server(("127.0.0.1", 0)) as hanging, registrars(1) as fakes:
        (alive,) = fakes
        stopped = f"127.0.0.1:{hanging.getsockname()[1]}"
        scene = next(each for each in SCENES if rank_copies([alive, stopped], each.digest)[0] == stopped)
        async with client_of(f"{alive},{stopped}") as (client, copies):
            await client.register(scene, [SCAN], Prior(), Sensor())
            await copies.check()
        assert sent(fakes[alive]) == [scene.digest]


async def test_a_name_is_resolved_to_the_copies_behind_it() -> None:
    with registrars(1) as fakes:
        (address,) = fakes
        async with client_of(f"dns:///localhost:{address.rpartition(':')[2]}") as (client, _):
            await client.register(SCENES[0], [SCAN], Prior(), Sensor())
        assert sent(fakes[address]) == [SCENES[0].digest]


async def test_a_message_beyond_grpcs_limit_is_told_from_a_busy_service() -> None:
    server = grpc.aio.server(options=[("grpc.max_receive_message_length", 1000)])
    registrar_pb2_grpc.add_RegistrarServiceServicer_to_server(registrar_pb2_grpc.RegistrarServiceServicer(), server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        async with client_of(f"127.0.0.1:{port}") as (client, _):
            with pytest.raises(RefusedForSize, match="larger than a message may be"):
                await client.register(SCENES[0], [many_samples()], Prior(), Sensor())
    finally:
        await server.stop(None)


def many_samples() -> Scan:
    return Scan(np.tile(SCAN.origins, (1000, 1)), np.tile(SCAN.directions, (1000, 1)), np.tile(SCAN.ranges, 1000))
