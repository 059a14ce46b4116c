"""The interactive session: asks for the plate at one distance after the other, and measures at each."""

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
from pretouch_sensor_gateway.calibration.device_client import RawReadings
from pretouch_sensor_gateway.calibration.motion_check import describe_motion
from pretouch_sensor_gateway.calibration.readings import find_step, noise_std, reject_outliers, split_by_module


class RangeReader(Protocol):
    """What the session needs of a `DeviceClient`."""

    def read(self, count: int, on_progress: Callable[[int], None]) -> RawReadings: ...


@dataclass(frozen=True)
class Plan:
    """What to measure: plate distances, m, in their order; measurements at each; s to wait before the first."""

    distances: tuple[float, ...]
    samples: int
    warm_up: float


class Session:
    """Measures at the distances of a plan.

    Args:
        reader: reads the device.
        plan: what to measure.
        console: where progress and problems are printed.
        ask: prints a question and returns the line typed; EOFError and KeyboardInterrupt end the session.

    Attributes:
        readings: distance, m -> (f, k), m, NaN where a module gave none; as far as the session has come.
        modules: k; 0 before the first measurement.
    """

    def __init__(self, reader: RangeReader, plan: Plan, console: Console, ask: Callable[[str], str]) -> None:
        self.readings: dict[float, Array] = {}
        self.modules = 0
        self._reader = reader
        self._plan = plan
        self._console = console
        self._ask = ask
        self._epoch: int | None = None
        self._refused: dict[float, list[list[float]]] = {}

    def run(self) -> bool:
        """Runs the session; False if it was interrupted: what was measured until then is in `readings`."""
        try:
            self._warm_up()
            self._measure_all()
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

    def _measure_all(self) -> None:
        """Asks for each distance in turn; the user may skip one or go back."""
        todo, done = deque(self._plan.distances), list[float]()
        while True:
            here = todo[0] if todo else None
            choices = [] if here is None else ["s: skip"]
            choices += [f"r: repeat {_mm(done[-1])}"] if done else []
            question = _prompt(here) + (f" ({', '.join(choices)}) " if choices else " ")
            try:
                answer = self._ask(question).strip().lower()
            except EOFError:
                if here is None:
                    return
                raise
            if answer == "r" and done:
                todo.appendleft(done.pop())
                self.readings.pop(todo[0], None)
            elif answer == "s" and here is not None:
                done.append(todo.popleft())
            elif answer:
                self._print(
                    f"{answer[:20]!r} is none of these: Enter{''.join(', ' + choice[0] for choice in choices)}."
                )
            elif here is None:
                return
            elif self._measure(here):
                done.append(todo.popleft())

    def _measure(self, distance: float) -> bool:
        """Measures at this distance; False if the readings were not accepted, after printing why."""
        columns = (TextColumn(_mm(distance)), BarColumn(), MofNCompleteColumn())
        try:
            with Progress(*columns, console=self._console, transient=True) as progress:
                task = progress.add_task("", total=self._plan.samples)
                readings = self._reader.read(self._plan.samples, lambda count: progress.update(task, completed=count))
        except PretouchError as error:
            self._print(f"{error.detail} {error.remedy} This distance can be repeated.")
            return False
        return self._accept(distance, readings)

    def _accept(self, distance: float, readings: RawReadings) -> bool:
        """Keeps the readings if they are good; else prints why not and returns False."""
        if self.modules not in (0, readings.raw.shape[1]):
            self._print(
                f"The device has {readings.raw.shape[1]} modules now, {self.modules} before: is it the same one?"
            )
            return False
        self.modules = readings.raw.shape[1]
        if self._epoch not in (None, readings.epoch):
            self._print("The device restarted since the distance before: its modules may be cold again.")
        self._epoch = readings.epoch
        columns = split_by_module(readings.raw)
        silent = [str(k) for k, column in enumerate(columns) if not len(column)]
        if len(silent) == self.modules:
            self._print("No module saw the plate; this distance can be repeated, or skipped.")
            return False
        doubts = [
            f"Module {k}: {doubt}"
            for k, column in enumerate(columns)
            if len(column) and (doubt := describe_motion(column, self._noise_elsewhere(distance, k)))
        ]
        if doubts:
            stds = [noise_std(column) if len(column) else 0.0 for column in columns]
            self._refused.setdefault(distance, []).append(stds)
            more = f", and {len(doubts) - 2} modules more" if len(doubts) > 2 else ""
            own = " Noise as large again is then taken for the module's own." if "noise" in "".join(doubts) else ""
            doubtful = "; ".join(doubts[:2]) + more
            self._print(f"Not taken, was the plate moved? {doubtful}. Hold it still and repeat, or skip.{own}")
            return False
        self.readings[distance] = readings.raw
        points = [reject_outliers(distance, column, find_step([column])) if len(column) else None for column in columns]
        means = ", ".join(f"{1000 * point.mean:.1f}" if point else "-" for point in points)
        self._print(f"{_mm(distance)}: the modules read {means} mm.")
        if silent:
            self._print(f"Without enough returns, and left out at {_mm(distance)}: module {', '.join(silent)}.")
        return True

    def _noise_elsewhere(self, distance: float, module: int) -> list[float]:
        """The module's noise at the other distances, and in attempts at this one that were refused."""
        columns = [split_by_module(raw)[module] for r, raw in self.readings.items() if r != distance]
        stds = [noise_std(column) for column in columns if len(column)]
        return stds + [attempt[module] for attempt in self._refused.get(distance, [])] if stds else []

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False)


def _prompt(distance: float | None) -> str:
    if distance is None:
        return "All distances are done. Press Enter to compute"
    return f"Put the plate at {_mm(distance)} in front of all modules, square to the beams, and press Enter"


def _mm(distance: float) -> str:
    return f"{1000 * distance:g} mm"
