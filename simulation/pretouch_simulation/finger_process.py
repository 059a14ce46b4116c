"""A simulated fingertip behind a real serial port: a process that owns a pty and speaks the gateway's binary format.

It prints one JSON line, `{"port": PATH}`, then sends frames at its rate and answers pings until its standard input
ends. Each input line announces a motion of the robot:

    {"start": seconds since the Unix epoch, "t": [n], "base_T_tip": [[16 numbers, row-major], ...]}

The tip is at waypoint i at `start + t[i]`, on straight lines and slerp between. Outside any such trajectory the finger
reports "no target". Like a real one it has a clock of its own, which starts anywhere and drifts.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import signal
import sys
import time
import tty
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import COUNTER_MODULUS, Identify, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply

from pretouch.errors import PretouchError
from pretouch.geometry import Array
from pretouch.trajectory import Trajectory

Measure = Callable[[Array], tuple[Array, NDArray[np.int64]]]
"""Module poses (n, 4, 4) in base to ranges (n,), m, NaN = none, and status codes (n,).

What a finger draws once a scan is here drawn once a batch.
"""

NO_TARGET = 7
MAX_DRIFT = 50e-6
MAX_RATE = 1000.0
_BATCH = 16
"""Samples measured at a time, ahead of their time: so short that frames and pings do not wait long for it."""
_OUTPUT_LIMIT = 4096
"""Bytes that wait for a host that does not read; frames beyond are lost, as in a real device's buffer."""


class Finger:
    """The device: samples at a rate, by a clock of its own. Host times are s since the Unix epoch.

    Args:
        measure: what the module sees.
        rate: samples per second.
        seed: of the clock's offset and drift.
        now: host time of the start.
    """

    def __init__(self, measure: Measure, rate: float, seed: int, now: float) -> None:
        rng = np.random.default_rng(seed)
        self._measure = measure
        self._rate = rate
        self._start = now
        self._first_tick = int(rng.integers(COUNTER_MODULUS))
        self._boot = int(rng.integers(2**16))
        self._speed = 1e6 * (1.0 + rng.uniform(-MAX_DRIFT, MAX_DRIFT))
        self._next = 0  # sequence number of the next sample
        self._wanted: deque[tuple[Trajectory, list[int]]] = deque()
        self._measured: dict[int, tuple[float, int]] = {}
        self._decoder = FrameDecoder()

    def micros(self, now: float) -> int:
        """The device's clock at a host time."""
        return (self._first_tick + round((now - self._start) * self._speed)) % COUNTER_MODULUS

    @property
    def next_due(self) -> float:
        """Host time of the next sample."""
        return self._time_of(self._next)

    @property
    def idle(self) -> bool:
        """Whether all announced samples are measured."""
        return not self._wanted

    def announce(self, motion: Trajectory) -> None:
        """The tip will move so, at these host times; where trajectories overlap the one announced last counts."""
        first = max(self._next, math.ceil((motion.t[0] - self._start) * self._rate))
        last = math.floor((motion.t[-1] - self._start) * self._rate)
        samples = [k for k in range(first, last + 1) if motion.t[0] <= self._time_of(k) <= motion.t[-1]]
        kept = [(other, [k for k in batch if not first <= k <= last]) for other, batch in self._wanted]
        new = [(motion, samples[k : k + _BATCH]) for k in range(0, len(samples), _BATCH)]
        self._wanted = deque(sorted((entry for entry in kept + new if entry[1]), key=lambda entry: entry[1][0]))

    def measure_ahead(self) -> None:
        """Measures the next few of the announced samples, each from the tip's exact pose at its own time."""
        motion, samples = self._wanted.popleft()
        ranges, status = self._measure(motion.at([self._time_of(k) for k in samples]))
        measured = zip(samples, ranges, status, strict=True)
        self._measured.update({k: (float(metres), int(code)) for k, metres, code in measured})

    def take_due(self, now: float) -> list[bytes]:
        """A frame for each sample whose time has come."""
        frames: list[bytes] = []
        while self.next_due <= now:
            while self._wanted and self._wanted[0][1][0] <= self._next:
                self.measure_ahead()
            metres, code = self._measured.pop(self._next, (math.nan, NO_TARGET))
            sequence = self._next % COUNTER_MODULUS
            measurement = Measurement(self._boot, sequence, self.micros(self.next_due), (metres,), (code,))
            frames.append(encode(measurement))
            self._next += 1
        return frames

    def reply_to(self, data: bytes, now: float) -> list[bytes]:
        """Replies to the requests that `data` completes."""
        replies = []
        for message in self._decoder.feed(data):
            if isinstance(message, Ping):
                replies.append(encode(PingReply(self._boot, message.sequence, self.micros(now))))
            elif isinstance(message, Identify):
                replies.append(encode(Identity(self._boot, "", 1, 1 / self._rate, "simulated finger")))
        return replies

    def _time_of(self, sample: int) -> float:
        return self._start + sample / self._rate


def motion_from(line: bytes) -> Trajectory:
    """The trajectory that an input line announces, in host times.

    Raises:
        ValueError, KeyError, TypeError, PretouchError: the line is not one.
    """
    said = json.loads(line)
    poses = np.array(said["base_T_tip"], dtype=np.float64).reshape(-1, 4, 4)
    return Trajectory(np.array(said["t"], dtype=np.float64) + float(said["start"]), poses)


def open_pty() -> tuple[int, int, str]:
    """A raw pty: its master, its slave (kept open, so that a host may come and go) and the slave's path."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave, os.ttyname(slave)


def play(finger: Finger, master: int, announcements: int) -> None:
    """Runs `finger` on a pty's master end until the file `announcements` ends."""
    output, line = bytearray(), b""
    while True:
        wait = max(0.0, finger.next_due - time.time()) if finger.idle else 0.0
        readable, _, _ = select.select([master, announcements], [master] if output else [], [], wait)
        if announcements in readable:
            data = os.read(announcements, 65536)
            if not data:
                return
            *lines, line = (line + data).split(b"\n")
            _announce(finger, lines)
        frames = finger.reply_to(os.read(master, 4096), time.time()) if master in readable else []
        for frame in frames + finger.take_due(time.time()):
            if len(output) + len(frame) <= _OUTPUT_LIMIT:
                output += frame
        if output:
            with suppress(BlockingIOError):
                del output[: os.write(master, output)]
        if not finger.idle:
            finger.measure_ahead()


def _announce(finger: Finger, lines: list[bytes]) -> None:
    for line in filter(None, lines):
        try:
            finger.announce(motion_from(line))
        except (ValueError, KeyError, TypeError, PretouchError) as error:
            print(f"an announced trajectory cannot be read: {error!r}", file=sys.stderr, flush=True)


def run(measure: Measure, rate: float, seed: int) -> None:
    """The whole process once it knows its world: opens the pty, says where it is, and plays until the input ends."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is the parent's to handle: it closes the input
    master, _, path = open_pty()
    print(json.dumps({"port": path}), flush=True)
    play(Finger(measure, rate, seed, time.time()), master, sys.stdin.fileno())


def main() -> int:
    """Command line; returns the exit status."""
    from pretouch_simulation.finger import FingerModel, measure_scan, realise  # numba takes half a second to load
    from pretouch_simulation.protocol import generator
    from pretouch_simulation.world import World

    parser = argparse.ArgumentParser(prog="python -m pretouch_simulation.finger_process", description=__doc__)
    parser.add_argument("--world", type=Path, required=True, help="file that World.save wrote")
    parser.add_argument("--sensor", type=FingerModel, choices=list(FingerModel), default=FingerModel.IDEAL)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=30.0, help=f"samples per second, at most {MAX_RATE:g}")
    arguments = parser.parse_args()
    if not 0 < arguments.rate <= MAX_RATE or arguments.seed < 0:
        parser.error(f"need 0 < rate <= {MAX_RATE:g} and a seed of 0 or more")

    try:
        world = World.load(arguments.world)
    except PretouchError as error:
        print(f"{error.detail} {error.remedy}", file=sys.stderr)
        return 2
    rng = np.random.default_rng(arguments.seed)
    finger = realise(arguments.sensor, generator("finger-model", arguments.seed))
    measure_scan(finger, world, np.eye(4)[None], rng)  # builds the ray caster before the first frame is due
    run(lambda poses: measure_scan(finger, world, poses, rng), arguments.rate, arguments.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
