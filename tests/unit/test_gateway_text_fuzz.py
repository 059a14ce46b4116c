"""The fuzzer's invariants over a fixed set of inputs, without the fuzzer."""

from __future__ import annotations

import pytest
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO, AutoDetectingParser
from pretouch_sensor_gateway.wire_formats.registry import create_parser

from fuzz import harness
from fuzz.mutation import mutate
from fuzz.seeds import seeds
from fuzz.streams import BARE, STREAMS


@pytest.mark.parametrize("seed", range(4))
def test_the_invariants_hold_for_mutated_streams(seed: int) -> None:
    for data in mutate(seeds(), 250, seed):
        harness.check_input(data)


@pytest.mark.parametrize("name", STREAMS)
def test_every_sample_stream_is_read_and_recognised_if_it_tells_its_unit(name: str) -> None:
    for stream in STREAMS[name]:
        named, recognised = create_parser(name), create_parser(AUTO)
        received = named.feed(stream)
        assert len(received) >= 4
        told = [] if name in BARE else received
        assert [repr(message) for message in recognised.feed(stream)] == [repr(message) for message in told]
        assert recognised.name == ("" if name in BARE else name)


def test_the_invariants_notice_a_format_that_loses_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    feed = AutoDetectingParser.feed
    monkeypatch.setattr(AutoDetectingParser, "feed", lambda self, data: feed(self, data)[1:])
    with pytest.raises(AssertionError):
        harness.check(AUTO, STREAMS["stm32duino"][0], 7)
