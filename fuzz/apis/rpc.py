"""gRPC calls with mutated requests, to all four services."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from itertools import islice
from typing import Any

import grpc

from fuzz.apis.counts import Counts
from fuzz.apis.messages import mutate, spoil
from fuzz.apis.seeds import OpenSession, good_requests
from pretouch.channel import open_sync_channel
from pretouch.client import GrpcClient
from pretouch.errors import PROBLEM_METADATA_KEY, PretouchError
from pretouch.v1 import detector_pb2, orchestrator_pb2, registrar_pb2, sensor_gateway_pb2

_DEADLINE = 40.0
_LISTEN = 1.0
"""s of a call, and of one that is listened to until it ends."""
_ENDLESS = ("StreamEvents", "StreamRanges", "StreamPoints")
_MOST_ANSWERS = 20
_OWN = (grpc.StatusCode.DEADLINE_EXCEEDED, grpc.StatusCode.CANCELLED, grpc.StatusCode.RESOURCE_EXHAUSTED)
"""Statuses that gRPC itself gives, without a problem document."""
_FILES = (orchestrator_pb2, detector_pb2, registrar_pb2, sensor_gateway_pb2)
METHODS = {
    f"/{service.full_name}/{method.name}": method
    for file in _FILES
    for service in file.DESCRIPTOR.services_by_name.values()
    for method in service.methods
}


def fuzz_rpc(addresses: Mapping[str, str], counts: Counts, seed: int, over: Callable[[], bool]) -> None:
    """Calls until `over()`.

    Args:
        addresses: of each service, by the word that its service's name begins with.
    """
    chance = random.Random(seed)
    with ExitStack() as stack:
        channels = {word: stack.enter_context(open_sync_channel(address)) for word, address in addresses.items()}
        client = stack.enter_context(GrpcClient(addresses["Orchestrator"], timeout=120.0))
        requests = good_requests(OpenSession(client))
        unknown = sorted(set(METHODS) - set(requests))
        assert not unknown, f"There is no good request for {unknown}."
        while not over():
            path = chance.choice(sorted(requests))
            channel = next(channel for word, channel in channels.items() if f".{word}" in path)
            try:
                messages = requests[path]()
            except PretouchError as error:  # such as a session that another request has cancelled meanwhile
                counts.fault(f"a good session: {type(error).__name__}: {error}")
                continue
            changed = chance.randrange(len(messages))
            data = [_serialise(m, chance) if k == changed else m.SerializeToString() for k, m in enumerate(messages)]
            _call(channel, path, data, counts)


def _serialise(message: Any, chance: random.Random) -> bytes:
    """Mostly changed, sometimes spoilt, sometimes as it is."""
    way = chance.random()
    if way < 0.8:
        message = mutate(message, chance)
    data: bytes = message.SerializeToString()
    return spoil(data, chance) if way > 0.92 else data


def _call(channel: grpc.Channel, path: str, requests: list[bytes], counts: Counts) -> None:
    method = METHODS[path]
    asked, answered = ("stream" if streams else "unary" for streams in _streams(method))
    call = getattr(channel, f"{asked}_{answered}")(path)
    timeout = _LISTEN if method.name in _ENDLESS else _DEADLINE
    name = "gRPC " + path.rpartition(".")[2]
    counts.send(name)
    try:
        answer = call(iter(requests) if asked == "stream" else requests[0], timeout=timeout)
        if answered == "stream":
            _listen(answer)
        counts.answer(name, "OK")
    except grpc.RpcError as error:
        code = error.code()
        counts.answer(name, code.name)
        described = any(key == PROBLEM_METADATA_KEY for key, _ in error.trailing_metadata() or ())
        if code in (grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN) or not (described or code in _OWN):
            counts.fault(f"{name} answered {code.name}: {error.details():.160}", requests)


def _streams(method: Any) -> tuple[bool, bool]:
    return method.client_streaming, method.server_streaming


def _listen(answers: Iterator[bytes]) -> None:
    for _ in islice(answers, _MOST_ANSWERS):
        pass
    answers.cancel()  # type: ignore[attr-defined]
