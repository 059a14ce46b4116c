"""Says why nothing of what a device sends is read: what came, the likely cause, and what to set."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO, likely_benewake
from pretouch_sensor_gateway.wire_formats.fixed_frames import FixedFrameParser
from pretouch_sensor_gateway.wire_formats.inference import infer
from pretouch_sensor_gateway.wire_formats.line_checks import TurnsCheck
from pretouch_sensor_gateway.wire_formats.line_splitter import LineSplitter
from pretouch_sensor_gateway.wire_formats.parser import Parser, Refusal
from pretouch_sensor_gateway.wire_formats.presets import TELLING
from pretouch_sensor_gateway.wire_formats.quoting import quote, quote_bytes
from pretouch_sensor_gateway.wire_formats.teraranger import TerarangerFrame

_BOOT = re.compile(
    r"ets \w{3} +\d|rst:0x|ESP-ROM:|Guru Meditation|Brownout detector|abort\(\) was called|Rebooting|Backtrace:|"
    r"Soft WDT|MPY: soft reboot|Auto-reload is (?:on|off)|boot: ESP-IDF|\bbooting\b|starting up",
    re.IGNORECASE,
)
_FIRST_BOOT_LINE = re.compile(r"ets \w{3} +\d|ESP-ROM:|MPY: soft reboot|\bbooting\b|starting up", re.IGNORECASE)
_OF_SOUND_FRAMES = (Refusal.VERSION, Refusal.KIND, Refusal.LENGTH, Refusal.IMPLAUSIBLE, Refusal.FOREIGN)
"""Reasons that say more than any guess: what was refused was a whole frame or line of the format."""
_BOOTS = 3
"""Boot messages of one kind from which a board restarts again and again."""
_PROMPT = re.compile(r">>> ?$|^>>> ?|Press any key to enter the REPL|MicroPython v\d|Adafruit CircuitPython \d")
_ERROR = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception|Interrupt)\b(?::.*)?$")
_TEXT = re.compile(rb"[\t\r\n\x1b\x20-\x7e]")
_LEAST_TEXT = 0.9
"""Share of printable bytes in what is text."""
_NUMBERS = re.compile(r"\d")
_REMEDY = 'docs/reference/wire-formats.md lists the formats; a pattern such as "{time:ms},{range:mm}" reads any line.'


def explain(recent: bytes, parser: Parser, refusal: Refusal | None, baud: int) -> str:
    """Why a device's bytes give no measurements, in sentences.

    Args:
        recent: what came last.
        parser: that does not read it.
        refusal: why it refused most of it; None: it has refused nothing lately.
        baud: at which the port is read.
    """
    if not recent:
        return "The port is open, but nothing arrives: does the board run, and does it send on this port?"
    if refusal in _OF_SOUND_FRAMES:
        return f"Frames arrive, but are refused: {refusal.value}. The last bytes are {quote_bytes(recent[-16:])}."
    wire_format = parser.name or AUTO
    if not _is_text(recent):
        return _explain_bytes(recent, wire_format, baud)
    lines = _lines(recent)
    stopped = _explain_stop(lines, recent)
    if stopped:
        return stopped
    if parser.problem:
        return parser.problem
    if not any(end in recent for end in b"\r\n"):
        text = recent.decode("ascii", "replace")
        return f"What arrives, {quote(text)}, has no line end: print each measurement with a line end after it."
    return _explain_lines(lines, wire_format)


def _is_text(recent: bytes) -> bool:
    return len(_TEXT.findall(recent)) >= _LEAST_TEXT * len(recent)


def _lines(recent: bytes) -> list[str]:
    """The whole lines in what came last; the first may lack its beginning, and is left out where there are others."""
    lines = [line for line in LineSplitter().feed(recent + b"\n") if isinstance(line, str) and line]
    return lines or [recent.decode("ascii", "replace").strip()]


def _explain_bytes(recent: bytes, wire_format: str, baud: int) -> str:
    for kind in (likely_benewake(), TerarangerFrame()):
        parser = FixedFrameParser(kind)
        parser.feed(recent)
        if parser.consecutive > 1 and parser.problem:
            return parser.problem
        if parser.consecutive > 1 and wire_format not in (AUTO, kind.name):
            return f'Frames of "{kind.name}" arrive: set format to that, or to "auto".'
        if parser.consecutive > 1 and wire_format == AUTO:
            return f'Frames of "{kind.name}" arrive, so far without a range.'
    return (
        f"What arrives is neither text nor a known frame: the last bytes are {quote_bytes(recent[-16:])}. The likely "
        f"cause is the baud rate: the port is read at {baud} baud. Set baud to what the board sends at (9600 and "
        "115200 are common); a board on USB has none, and then sends a format that is not known here."
    )


def _explain_stop(lines: Sequence[str], recent: bytes) -> str:
    """Whether the program on the board has ended, or starts again and again."""
    starts = Counter(match[0].lower() for line in lines if (match := _FIRST_BOOT_LINE.search(line)))
    if starts and starts.most_common(1)[0][1] >= _BOOTS:
        cause = next((line for line in reversed(lines) if re.search(r"Guru|Brownout|abort|panic|WDT", line)), lines[-1])
        return (
            f"The board restarts again and again ({starts.most_common(1)[0][1]} times lately); its last words are "
            f"{quote(cause)}. Check its power supply and its program."
        )
    error = next((line for line in reversed(lines[-12:]) if _ERROR.match(line.strip())), "")
    ended = recent.rstrip().endswith(b">>>") or any(_PROMPT.search(line) for line in lines[-4:])
    if ended or any("Traceback" in line for line in lines[-12:]):
        why = f"ended with the error {quote(error)}" if error else "is not running"
        prompt = " and waits at the prompt >>>" if ended else ""
        return f"The program on the board {why}{prompt}. Mend it and start it again: restart the board, or send Ctrl-D."
    return ""


def _explain_lines(lines: Sequence[str], wire_format: str) -> str:
    named = wire_format != AUTO
    with_numbers = [line for line in lines if _NUMBERS.search(line) and not _BOOT.search(line)]
    last = quote((with_numbers or lines)[-1])
    refusal = f"The last line, {last}, is not of the format {quote(wire_format)}." if named else ""
    preset = next((each for each in TELLING if each.told_by(lines)), None)
    if preset is not None and preset.name != wire_format:
        return f'{refusal} It looks like "{preset.name}": set format to that, or to "auto".'.strip()
    inference = infer(lines[-60:])
    if inference is None:
        seen = f"The last line that came is {last}" if not named else refusal[:-1]
        return f"{seen}: no line of a kind with a range comes repeatedly. {_REMEDY}"
    if inference.question:
        return f"{refusal} {_alternation(lines)}{inference.question}.".strip()
    if named:
        return f"{refusal} Set format = '{inference.pattern}', or \"auto\"."
    return f"Lines such as {last} come; more of them are needed to tell their columns."


def _alternation(lines: Sequence[str]) -> str:
    """A warning if bare numbers are of two sensors in turns."""
    check = TurnsCheck(0.001)
    for line in lines:
        if re.fullmatch(r"\s*\d+(?:\.\d+)?\s*", line):
            check.add(float(line) / 1000, line)
    return "Several sensors seem to print in turns, which nothing tells apart. " if check.detected else ""
