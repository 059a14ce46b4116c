"""The fuzzer of the APIs reaches every method, and its changed messages can still be parsed."""

import random
from typing import Any

from fuzz.apis.counts import Counts
from fuzz.apis.messages import mutate, spoil
from fuzz.apis.rpc import METHODS
from fuzz.apis.seeds import OpenSession, good_requests

NO_CLIENT: Any = None


def test_there_is_a_good_request_for_every_method() -> None:
    assert set(good_requests(OpenSession(NO_CLIENT))) == set(METHODS)


def test_a_changed_message_can_be_parsed_and_is_the_same_for_the_same_seed() -> None:
    (good,) = good_requests(OpenSession(NO_CLIENT))["/pretouch.v1.OrchestratorService/CreateSession"]()
    changed = [mutate(good, random.Random(seed)).SerializeToString() for seed in range(200)]
    for seed, data in enumerate(changed):
        type(good).FromString(data)
        assert mutate(good, random.Random(seed)).SerializeToString() == data
    assert len(set(changed)) > 150
    assert good.SerializeToString() not in [spoil(good.SerializeToString(), random.Random(seed)) for seed in range(20)]


def test_a_request_without_an_answer_does_not_add_up() -> None:
    counts = Counts()
    counts.send("GET /")
    assert not counts.add_up()
    counts.answer("GET /", "200")
    assert counts.add_up()
