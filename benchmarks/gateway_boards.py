"""Plays what well-known boards print on pseudo-terminals, and says what the gateway makes of it.

`python -m benchmarks.gateway_boards [FOLDER] [--json OUT] [--markdown OUT]`: the boards of `board_cases`, and of a
folder with `index.json` and a file of bytes for each. Each is read twice: with `auto`, and with the format that its
user would name.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import os
import pty
import statistics
import tty
from dataclasses import asdict, dataclass, field
from pathlib import Path

import structlog
from pretouch_sensor_gateway.range_batch import RangeBatch
from pretouch_sensor_gateway.serial_source import SerialSource
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO
from pretouch_sensor_gateway.wire_formats.registry import create_parser
from pretouch_sensor_gateway.wire_formats.text import Modules

from benchmarks.board_cases import CASES, BoardCase, load_cases

_AT_ONCE = 12
"""Boards that are played at the same time."""
_SETTLED = 1.5
"""Seconds after which the rate is counted: at 10 Hz `auto` needs eight lines to infer a pattern."""
_TOLERANCE = {"": 1.05, "mm": 1.05, "cm": 10.05, "m": 10.05}
"""Millimetres by which a right range differs: boards round or truncate to whole millimetres, or to centimetres."""
_AT_FIRST, _SKIPPED = 60, 16
"""True ranges that may be skipped before the first range, and later."""
NAMED: dict[str, tuple[str, int | None]] = {
    "pololu_vl53l0x": ("pololu-vl53l0x", None),
    "pololu_vl53l1x_details": ("pololu-vl53l1x-details", None),
    "pololu_vl6180x_ambient": ("pololu-vl6180x-ambient", None),
    "pololu_debug_line": ("pololu-vl53l0x", None),
    "adafruit_vl6180x": ("adafruit-vl6180x", None),
    "adafruit_vl53l0x": ("adafruit-vl53l0x", None),
    "sparkfun_vl53l5cx_8x8": ("sparkfun-vl53l5cx-8x8", 64),
    "sparkfun_vl53l1x": ("sparkfun-vl53l1x", None),
    "stm32duino_x_nucleo": ("x-nucleo", 1),
    "tf_luna_9byte": ("tf-luna", None),
    "tfmini_pixhawk_text": ("tfmini-text", None),
    "teraranger_evo_text": ("teraranger-evo", None),
    "serial_plotter_labels": ("distance:{range:mm},signal:{any}", None),
    "esp32_json": ('{{"t": {time:ms}, "range_mm": {range:mm}}}', None),
    "esp_idf_log": ("esp-idf", None),
    "circuitpython_raw_cm": ("circuitpython-vl53l1x", None),
    "csv_micros": ("{time:us},{range:mm}", None),
    "csv_range_status": ("{range:mm},{status}", None),
    "l0x_bad_status": ("{range:mm},{status}", None),
    "vl53l5cx_csv64": ("millimetres", 64),
}
"""The format, and the number of modules, that a user would name for a case of the folder."""


@dataclass(frozen=True)
class Result:
    """What came of one board.

    Attributes:
        format, unit, problem: as the status says at the end.
        rate: measurements a second, once the format is known; expected: of the board.
        modules: of each measurement.
        median_error: mm, of the first module's ranges that fit the truth; NaN: there are none.
        wrong: ranges that fit no true one in order, within the step of what the board prints.
        false_ranges: ranges where there was no target; missed: targets without a range.
        outcome: "read", "refused" with a reason, or "wrong".
    """

    name: str
    asked: str
    format: str
    unit: str
    rate: float
    expected: float
    modules: int
    median_error: float
    wrong: int
    false_ranges: int
    missed: int
    problem: str
    outcome: str


async def play(case: BoardCase, asked: str) -> Result:
    """Plays a board at its own pace on a pseudo-terminal, and reads it as the gateway does."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    loop = asyncio.get_running_loop()
    taken: list[tuple[float, RangeBatch]] = []
    start = float("inf")
    parser = create_parser(asked, Modules(case.modules))
    source = SerialSource(
        os.ttyname(slave),
        parser,
        DEFAULT_BAUD,
        None,
        None,
        lambda batch: taken.append((loop.time() - start, batch)),
        lambda _: None,
        structlog.get_logger(),
    )
    running = asyncio.create_task(source.run())
    try:
        while source.status().connections == 0:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        start = loop.time()
        for t, data in case.writes:
            await asyncio.sleep(max(0.0, start + t - loop.time()))
            os.write(master, data)
        await asyncio.sleep(max(0.1, start + 5.2 - loop.time()))
        status = source.status()
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        os.close(master)
        os.close(slave)
    return _result(case, asked, taken, status.format, status.unit, status.problem)


def _result(
    case: BoardCase, asked: str, taken: list[tuple[float, RangeBatch]], name: str, unit: str, problem: str
) -> Result:
    ranges = [float(row[0]) * 1000 for _, batch in taken for row in batch.raw]
    truth = [math.nan if value is None else value for _, value in case.truth]
    comparison = compare(ranges, truth, _TOLERANCE[unit])
    later = sum(len(batch) for at, batch in taken if at > _SETTLED)
    later_true = sum(t > _SETTLED for t, _ in case.truth)
    span = case.truth[-1][0] - _SETTLED
    outcome = "read" if later > 0.85 * later_true else "refused" if problem else "silent"
    if (comparison.wrong or comparison.false_ranges) and not problem:
        outcome = "wrong"
    return Result(
        case.name,
        asked,
        name,
        unit,
        later / span,
        later_true / span,
        max((batch.modules for _, batch in taken), default=0),
        statistics.median(comparison.errors) if comparison.errors else math.nan,
        comparison.wrong,
        comparison.false_ranges,
        comparison.missed,
        problem,
        outcome,
    )


@dataclass
class Comparison:
    """Ranges of a module beside the truth, both in order: errors of those that fit, mm, and counts of the rest."""

    errors: list[float] = field(default_factory=list)
    wrong: int = 0
    false_ranges: int = 0
    missed: int = 0


def compare(ranges: list[float], truth: list[float], tolerance: float) -> Comparison:
    """Compares ranges, mm, with true ones, NaN for none: each with the next true one that it fits, skipping a few.

    A board may print nothing without a target, and the lines by which a format was recognised are not passed on.
    """
    result = Comparison()
    at = len(truth) - len(ranges)  # so many were not passed on at the start, unless others are missing later
    if not (0 <= at <= _AT_FIRST and ranges and abs(ranges[0] - truth[at]) <= tolerance):
        at = 0
    for k, value in enumerate(ranges):
        skipped = _AT_FIRST if k == 0 and at == 0 else 1 if math.isnan(value) else _SKIPPED
        ahead = truth[at : at + skipped + 1]
        fits = (
            j
            for j, true in enumerate(ahead)
            if (math.isnan(value) and math.isnan(true)) or abs(value - true) <= tolerance
        )
        match = next(fits, None)
        if match is not None:
            at += match + 1
            if not math.isnan(value):
                result.errors.append(abs(value - truth[at - 1]))
            continue
        true = truth[min(at, len(truth) - 1)]
        result.missed += math.isnan(value)
        result.false_ranges += math.isnan(true) and not math.isnan(value)
        result.wrong += not math.isnan(true) and not math.isnan(value)
        at += 1
    return result


async def run(cases: list[BoardCase]) -> list[Result]:
    """Both runs of each case, some at a time."""
    jobs = [(case, asked) for case in cases for asked in (AUTO, case.named)]
    results: list[Result] = []
    for first in range(0, len(jobs), _AT_ONCE):
        results += await asyncio.gather(*(play(*job) for job in jobs[first : first + _AT_ONCE]))
    return results


def markdown(results: list[Result]) -> str:
    """The table of docs/results/boards.md."""
    lines = [
        "| board | format asked | read as | unit | Hz (sent) | modules | median error, mm | wrong, false, missed |"
        " outcome | `problem` |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for each in results:
        error = "" if math.isnan(each.median_error) else f"{each.median_error:.1f}"
        cells = (
            each.name,
            _code(each.asked),
            _code(each.format) if each.format != each.asked else "same",
            each.unit,
            f"{each.rate:.1f} ({each.expected:.1f})",
            str(each.modules or ""),
            error,
            f"{each.wrong}, {each.false_ranges}, {each.missed}" if each.modules else "",
            each.outcome,
            each.problem.replace("|", "\\|"),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="with index.json")
    parser.add_argument("--json", type=Path, help="write the results to this file")
    parser.add_argument("--markdown", type=Path, help="write the table to this file")
    out = parser.parse_args()
    cases = [*(load_cases(out.folder, NAMED) if out.folder else ()), *CASES]
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(40))
    results = asyncio.run(run(cases))
    table = markdown(results)
    print(table)
    for asked in ("auto", "named"):
        counted = [each.outcome for each in results if (each.asked == AUTO) == (asked == "auto")]
        print(
            f"{asked}: " + ", ".join(f"{counted.count(kind)} {kind}" for kind in ("read", "refused", "silent", "wrong"))
        )
    if out.json:
        out.json.write_text(json.dumps([asdict(each) for each in results], indent=1) + "\n")
    if out.markdown:
        out.markdown.write_text(table)


if __name__ == "__main__":
    main()
