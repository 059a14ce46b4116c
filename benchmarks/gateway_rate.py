"""The highest rate of frames that one device can hold without loss, beside a bare reader of the same line.

A rate is held if the line never keeps the device waiting for long, and each frame reaches the one listener. It is
sought by doubling and bisection with short trials, then must be held for longer, or is lowered until it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from benchmarks import gateway_fingers, gateway_peers, gateway_subscriber
from benchmarks.gateway_fingers import Job, Sent
from benchmarks.gateway_peers import Reading
from benchmarks.gateway_process import GatewayProcess
from benchmarks.gateway_worker import Worker

TOLERANCE = 0.02
"""Share of its time by which a device may end late."""
_HICCUP = 0.02
"""Seconds more, for a machine that does other things too."""
_RESOLUTION, _STEP_DOWN = 1.1, 1.25
"""Ratios of neighbouring rates, in seeking and in lowering one that does not last."""
_TRIES = 2
"""A rate that another job on the machine spoils is tried again."""
_DISTINCT = 1000
_GRACE = 1.0
"""Seconds after the last byte in which all must have arrived."""
_PATIENCE = 10.0


@dataclass(frozen=True)
class Trial:
    """Whether a rate was held, and if not, why."""

    held: bool
    why: str = ""


def measure(
    search: tuple[float, float], probe: float, seconds: float, seed: int, advance: Callable[[str], None]
) -> list[dict[str, Any]]:
    """A row each for the gateway, the bare reader, and the bare reader that decodes.

    Args:
        search: Hz, where doubling begins and where it ends.
        probe: s of a trial while seeking.
        seconds: for which the rate is held in the end.
    """
    rows = []
    with Worker(gateway_fingers.run, 2, seed) as fingers:
        with (
            GatewayProcess(fingers.ready[:1]) as gateway,
            Worker(gateway_subscriber.run, gateway.address, gateway.devices) as subscriber,
        ):
            _through_gateway(100.0, 0.6, fingers, gateway, subscriber)  # recognised, clock found

            def trial(rate: float, seconds: float) -> Trial:
                return _through_gateway(rate, seconds, fingers, gateway, subscriber)

            rows.append({"reader": "gateway", **_highest(trial, search, probe, seconds, advance, "gateway")})
        with Worker(gateway_peers.read_ports, fingers.ready[1:]) as reader:
            for name, decode in (("pyserial + FrameDecoder", True), ("pyserial, counting zeros", False)):

                def bare(rate: float, seconds: float, decode: bool = decode) -> Trial:
                    return _bare(rate, seconds, fingers, reader, decode)

                rows.append({"reader": name, **_highest(bare, search, probe, seconds, advance, name)})
    return rows


def _highest(
    trial: Callable[[float, float], Trial],
    search: tuple[float, float],
    probe: float,
    seconds: float,
    advance: Callable[[str], None],
    name: str,
) -> dict[str, Any]:
    why: list[str] = []

    def holds(rate: float, seconds: float) -> bool:
        for _ in range(_TRIES):
            advance(f"rate of {name}: {rate:,.0f} Hz for {seconds:g} s")
            outcome = trial(rate, seconds)
            if outcome.held:
                return True
            why.append(outcome.why)
        return False

    rate, most = search
    while rate < most and holds(2 * rate, probe):
        rate *= 2
    above = rate if rate >= most else 2 * rate
    while above / rate > _RESOLUTION:
        middle = (rate * above) ** 0.5
        rate, above = (middle, above) if holds(middle, probe) else (rate, middle)
    while not holds(rate, seconds):
        rate /= _STEP_DOWN
        if rate < search[0] / 2:
            raise RuntimeError(f"{name} holds no rate: {why[-1]}")
    return {"highest_hz": rate, "held_s": seconds, "beyond": why[-1] if why else ""}


def _through_gateway(
    rate: float, seconds: float, fingers: Worker, gateway: GatewayProcess, subscriber: Worker
) -> Trial:
    count = round(rate * seconds)
    (before,) = gateway.statuses()
    (sent,) = fingers.ask(
        Job((0,), (0.0,), count, rate, gateway_fingers.start_of_job(count)), _PATIENCE + 2 * seconds + 1e-4 * count
    )
    (received,) = subscriber.ask((len(sent.stamps), _GRACE), _PATIENCE)
    (after,) = gateway.statuses()
    losses = {
        "missing": len(sent.stamps) - len(received.keys),
        "lost": after.device.lost_frames - before.device.lost_frames,
        "refused": after.device.bad_frames - before.device.bad_frames,
        "overrun": after.overrun - before.overrun,
    }
    return _assess(sent, count, seconds, {name: number for name, number in losses.items() if number})


def _bare(rate: float, seconds: float, fingers: Worker, reader: Worker, decode: bool) -> Trial:
    count, start = round(rate * seconds), gateway_fingers.start_of_job(_DISTINCT)
    reader.tell(Reading(count, start, _GRACE, decode))
    (sent,) = fingers.ask(Job((1,), (0.0,), count, rate, start, _DISTINCT), _PATIENCE + 2 * seconds)
    missing = len(sent.stamps) - len(reader.answer(_PATIENCE + seconds))
    return _assess(sent, count, seconds, {"missing": missing} if missing else {})


def _assess(sent: Sent, count: int, seconds: float, losses: dict[str, int]) -> Trial:
    if losses:
        return Trial(False, ", ".join(f"{number} {name}" for name, number in losses.items()))
    if len(sent.stamps) < count or sent.late > TOLERANCE * seconds + _HICCUP:
        return Trial(False, "the reader is too slow" if sent.held_back else "the sender is too slow")
    return Trial(True)
