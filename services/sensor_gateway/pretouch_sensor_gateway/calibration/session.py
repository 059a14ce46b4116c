"""The conversation with the person who holds the plate: distance after distance, until all are measured."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pretouch.errors import PretouchError
from pretouch.geometry import Array
from pretouch_sensor_gateway.calibration.motion import motion
from pretouch_sensor_gateway.calibration.readings import cleaned, returns, spread, step_of
from pretouch_sensor_gateway.calibration.subject import Frames


class Measured(Protocol):
    """What the session needs of a `Subject`."""

    def frames(self, count: int, told: Callable[[int], None]) -> Frames: ...


@dataclass(frozen=True)
class Plan:
    """What to measure: plate distances, m, in their order; measurements at each; s to wait before the first."""

    distances: tuple[float, ...]
    samples: int
    warm_up: float


class Session:
    """Measures a plan.

    Args:
        subject: the device.
        plan: what to measure.
        console: where it is talked about.
        ask: prints a question and returns the line that was answered; EOFError and KeyboardInterrupt end the session.

    Attributes:
        readings: distance, m -> (f, k), m, NaN where a module gave none; as far as the session has come.
        modules: k; 0 before the first measurement.
    """

    def __init__(self, subject: Measured, plan: Plan, console: Console, ask: Callable[[str], str]) -> None:
        self.readings: dict[float, Array] = {}
        self.modules = 0
        self._subject = subject
        self._plan = plan
        self._console = console
        self._ask = ask
        self._epoch: int | None = None
        self._refused: dict[float, list[list[float]]] = {}

    def run(self) -> bool:
        """Whether it came to its end; False: it was interrupted, and what was measured stays in `readings`."""
        try:
            self._warm_up()
            self._converse()
        except (KeyboardInterrupt, EOFError):
            self._console.print()
            return False
        return True

    def _warm_up(self) -> None:
        """Waits; Ctrl-C ends only the waiting, as the modules may be warm already."""
        end = time.monotonic() + self._plan.warm_up
        columns = (TextColumn("Warming up (Ctrl-C: go on now)"), BarColumn(), TimeRemainingColumn())
        try:
            with Progress(*columns, console=self._console, transient=True) as progress:
                task = progress.add_task("", total=self._plan.warm_up)
                while (left := end - time.monotonic()) > 0:
                    progress.update(task, completed=self._plan.warm_up - left)
                    time.sleep(min(left, 0.1))
        except KeyboardInterrupt:
            self._console.print("The rest of the warm-up is left out.")

    def _converse(self) -> None:
        ahead, behind = deque(self._plan.distances), list[float]()
        while True:
            here = ahead[0] if ahead else None
            choices = [] if here is None else ["s: skip"]
            choices += [f"r: repeat {_mm(behind[-1])}"] if behind else []
            question = _question(here) + (f" ({', '.join(choices)}) " if choices else " ")
            try:
                answer = self._ask(question).strip().lower()
            except EOFError:
                if here is None:
                    return
                raise
            if answer == "r" and behind:
                ahead.appendleft(behind.pop())
                self.readings.pop(ahead[0], None)
            elif answer == "s" and here is not None:
                behind.append(ahead.popleft())
            elif answer:
                self._say(f"{answer[:20]!r} is none of these: Enter{''.join(', ' + choice[0] for choice in choices)}.")
            elif here is None:
                return
            elif self._measure(here):
                behind.append(ahead.popleft())

    def _measure(self, distance: float) -> bool:
        """Whether the readings at this distance were taken; if not, the person was told why."""
        columns = (TextColumn(_mm(distance)), BarColumn(), MofNCompleteColumn())
        try:
            with Progress(*columns, console=self._console, transient=True) as progress:
                task = progress.add_task("", total=self._plan.samples)
                frames = self._subject.frames(self._plan.samples, lambda count: progress.update(task, completed=count))
        except PretouchError as error:
            self._say(f"{error.detail} {error.remedy} This distance can be repeated.")
            return False
        return self._accepted(distance, frames)

    def _accepted(self, distance: float, frames: Frames) -> bool:
        if self.modules not in (0, frames.raw.shape[1]):
            self._say(f"The device has {frames.raw.shape[1]} modules now, {self.modules} before: is it the same one?")
            return False
        self.modules = frames.raw.shape[1]
        if self._epoch not in (None, frames.epoch):
            self._say("The device started anew since the distance before: its modules may be cold again.")
        self._epoch = frames.epoch
        columns = returns(frames.raw)
        silent = [str(k) for k, column in enumerate(columns) if not len(column)]
        if len(silent) == self.modules:
            self._say("No module saw the plate; this distance can be repeated, or skipped.")
            return False
        doubts = [
            f"Module {k}: {doubt}"
            for k, column in enumerate(columns)
            if len(column) and (doubt := motion(column, self._elsewhere(distance, k)))
        ]
        if doubts:
            stds = [spread(column) if len(column) else 0.0 for column in columns]
            self._refused.setdefault(distance, []).append(stds)
            more = f", and {len(doubts) - 2} modules more" if len(doubts) > 2 else ""
            own = " Noise as large again is then taken for the module's own." if "noise" in "".join(doubts) else ""
            said = "; ".join(doubts[:2]) + more
            self._say(f"Not taken, was the plate moved? {said}. Hold it still and repeat, or skip.{own}")
            return False
        self.readings[distance] = frames.raw
        points = [cleaned(distance, column, step_of([column])) if len(column) else None for column in columns]
        means = ", ".join(f"{1000 * point.mean:.1f}" if point else "-" for point in points)
        self._say(f"{_mm(distance)}: the modules read {means} mm.")
        if silent:
            self._say(f"Without enough returns, and left out at {_mm(distance)}: module {', '.join(silent)}.")
        return True

    def _elsewhere(self, distance: float, module: int) -> list[float]:
        """The module's noise at the other distances, and in attempts at this one that were refused."""
        columns = [returns(raw)[module] for r, raw in self.readings.items() if r != distance]
        stds = [spread(column) for column in columns if len(column)]
        return stds + [attempt[module] for attempt in self._refused.get(distance, [])] if stds else []

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False)


def _question(distance: float | None) -> str:
    if distance is None:
        return "All distances are done. Press Enter to compute"
    return f"Put the plate at {_mm(distance)} in front of all modules, square to the beams, and press Enter"


def _mm(distance: float) -> str:
    return f"{1000 * distance:g} mm"
