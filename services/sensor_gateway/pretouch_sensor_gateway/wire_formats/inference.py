"""Infers a line pattern from lines that no preset reads: certain of it, or with a question for the user."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from pretouch.errors import InvalidInput
from pretouch_sensor_gateway.wire_formats.labels import (
    says_module,
    says_other_length,
    says_range,
    says_status,
    says_time,
)
from pretouch_sensor_gateway.wire_formats.line_format import LineFormat, LineReading
from pretouch_sensor_gateway.wire_formats.numbers_on_lines import Template, Value, find_values
from pretouch_sensor_gateway.wire_formats.quoting import quote
from pretouch_sensor_gateway.wire_formats.range_text import METRES

ENOUGH = 4
"""Lines of one kind from which a pattern is inferred."""
ENOUGH_FOR_TIME = 12
"""Lines of one kind from which a column is told to be a time."""
_CHARACTERS = 2500
"""Of the last lines that are looked at, where they are more than are needed: numbers take a while to find."""
_UNEVENNESS = 4.0
"""Largest step of a time relative to its least: a line may be late, and one or two may be lost."""
_TIME_STEPS = {"s": (0.0025, 1.0), "ms": (2.5, 1000.0), "us": (2500.0, 1e6)}
"""Steps from line to line at 1 to 400 Hz, in each unit of time: no two overlap."""
_UNIT_OF_ITS_OWN = re.compile(r"\s*(?:[A-Za-z]{1,6}|%)(?![A-Za-z])")
_FOREIGN_UNIT = re.compile(r"\s*(?:in|inch(?:es)?|ft|feet|\"|us|µs)(?!\w)", re.IGNORECASE)
_SMALL_CODES = frozenset(range(16)) | {255}


@dataclass(frozen=True)
class Inference:
    """What lines of one kind seem to be.

    Attributes:
        pattern: that reads them; "" if there is none.
        question: what the user must say before it can be used; "" if nothing.
        pending: whether more lines would tell more.
    """

    pattern: str
    question: str = ""
    pending: bool = False


@dataclass(frozen=True)
class _Kind:
    """Lines with the same template, and the values on each."""

    lines: list[str]
    rows: list[list[Value]]

    def column(self, index: int) -> list[Value]:
        return [row[index] for row in self.rows]


def infer(lines: Sequence[str]) -> Inference | None:
    """What the lines seem to be; None if no kind of line with numbers comes often enough."""
    kinds: dict[Template, _Kind] = {}
    longest = max(map(len, lines), default=1)
    for line in lines[-max(ENOUGH_FOR_TIME + 1, _CHARACTERS // longest) :]:
        template, values = find_values(line)
        if any(value.kind in ("number", "comma", "word") for value in values):
            kind = kinds.setdefault(template, _Kind([], []))
            kind.lines.append(line)
            kind.rows.append(values)
    often = sorted((kind for kind in kinds.values() if len(kind.lines) >= ENOUGH), key=lambda kind: -len(kind.lines))
    with_unit = [kind for kind in often if any(value.unit for value in kind.rows[-1])]
    if len(with_unit) > 1:
        return _several(with_unit)
    if with_unit:
        return _infer_kind(with_unit[0])
    labelled = [kind for kind in often if _range_columns(kind)]
    if labelled or often:
        return _infer_kind((labelled or often)[0], _header(lines, often[0]))
    return None


def _several(kinds: list[_Kind]) -> Inference:
    first, second = kinds[0].lines[-1], kinds[1].lines[-1]
    unit = next(value.unit for value in kinds[0].rows[-1] if value.unit)
    return Inference(
        "",
        f"Two kinds of lines hold a length, {quote(first)} and {quote(second)}: which is the range, or are both, "
        f'of two modules? Set format to a pattern of the one, as "Distance: {{range:{unit}}} {unit}", or of both, with '
        f'the module\'s name as {{module}}: "{{module}}: {{range:{unit}}} {unit}"',
    )


def _infer_kind(kind: _Kind, header: Sequence[str] = ()) -> Inference:
    if header:
        kind = _label(kind, header)
    elif all(value.continues for value in kind.rows[-1]) and not kind.rows[-1][-1].after.strip(" ,;"):
        return _infer_bare(kind)
    columns = _range_columns(kind)
    if not columns:
        return Inference(
            "", f"Which number is the range on lines such as {quote(kind.lines[-1])}, and in which unit? Set format to "
            f'a pattern, as "{_pattern(kind, {len(kind.rows[-1]) - 1: "{range:mm}"}, header)}"'
        )  # fmt: skip
    units = {kind.rows[-1][column].unit for column in columns if kind.rows[-1][column].unit}
    others = [column for column in columns if says_other_length(kind.rows[-1][column].words)]
    if len(units) > 1:
        columns = _finest_of_the_same(kind, columns)
        units = {kind.rows[-1][column].unit for column in columns}
    if len(others) < len(columns):
        columns = [column for column in columns if column not in others]
    unit = next(iter(units)) if len(units) == 1 else ""
    commas = [column for column in columns if any(value.kind == "comma" for value in kind.column(column))]
    fields = {column: f"{{range:{unit or 'mm'}{',' if column in commas else ''}}}" for column in columns}
    pending, unclear_status = _add_other_fields(kind, fields)
    pattern = _pattern(kind, fields, header)
    example = quote(kind.lines[-1])
    labelled = [kind.rows[-1][column] for column in columns]
    named = all(_says_range(value) or (not value.words and len(columns) == 1) for value in labelled)
    doubtful = bool(others) or not named or _nameless(kind, columns, fields)
    if _FOREIGN_UNIT.match(kind.rows[-1][columns[0]].after):
        question = f"Lines such as {example} are not in mm, cm or m: print one of these"
    elif commas:
        question = f"Has a line such as {example} a decimal comma? If so set format = {_quoted(pattern)}"
    elif not unit:
        question = (
            f"Lines such as {example} do not say their unit: mm, cm or m? "
            f"Set format = {_quoted(pattern)}, or with cm or m instead of mm"
        )
    elif doubtful:
        question = (
            f"Which numbers are ranges on lines such as {example}? Set format = {_quoted(pattern)}, or less of it"
        )
    elif unclear_status:
        question = f"Which status is good on lines such as {example}? Set format = {_quoted(pattern)}, with its code"
    else:
        question = (
            "" if _reads(pattern, kind.lines) else f"Lines such as {example} cannot be read as {_quoted(pattern)}"
        )
    return Inference(pattern, question, pending)


def _infer_bare(kind: _Kind) -> Inference:
    """Lines of numbers alone: only the user knows their unit."""
    columns = len(kind.rows[-1])
    example = quote(kind.lines[-1])
    separator = "," if "," in kind.lines[-1] else ";" if ";" in kind.lines[-1] else " "
    if columns == 1:
        return Inference(
            "",
            f'Lines are bare numbers such as {example}: mm, cm or m? Set format = "millimetres", "centimetres" or '
            '"metres", or the name of the sketch',
        )
    fields = ["{range:mm}"] * columns
    said = []
    time = next((column for column in (0, columns - 1) if _time_unit(kind.column(column))), None)
    if time is not None:
        unit = _time_unit(kind.column(time))
        fields[time] = f"{{time:{unit}}}"
        said.append(f"number {time + 1} rises like a time in {unit}")
    codes = [column for column in range(columns) if _is_status(kind, column, time)]
    if len(codes) == 1 and columns <= 5:
        fields[codes[0]] = "{status}"
        said.append(f"number {codes[0] + 1} looks like a status")
    ranges = fields.count("{range:mm}")
    if ranges > 3:
        pattern = " ".join(f for f in ["{time}" * (time == 0), "{ranges:mm}", "{time}" * (time == columns - 1)] if f)
        pattern = pattern.replace("{time}", fields[time] if time is not None else "")
    else:
        pattern = separator.join(fields)
    if columns in (4, 8):
        said.append(f'if they are rows of a multizone sensor set format = "vl53l5cx-rows-{columns}x{columns}"')
    if columns == 2 and separator == "," and time is None:
        said.append("the comma may also be a decimal comma, {range:cm,}")
    note = f" ({'; '.join(said)})" if said else ""
    choice = "which are ranges, and in" if ranges > 1 else "is the range in"
    return Inference(
        "",
        f"Lines are {columns} bare numbers such as {example}{note}: {choice} mm, cm or m? Set format = "
        f'"{pattern}", or with cm or m, and {{any}} for a column that is no range',
    )


def _label(kind: _Kind, header: Sequence[str]) -> _Kind:
    """The lines of a table with the names of its columns as labels."""
    rows = []
    for row in kind.rows:
        labelled = [find_values(f"{name}: {value.text}")[1][-1] for name, value in zip(header, row, strict=True)]
        rows.append(labelled)
    return _Kind(kind.lines, rows)


def _header(lines: Sequence[str], kind: _Kind) -> list[str]:
    """The names of the columns, if a line of such names came before lines of as many numbers."""
    for line in lines:
        names = [name.strip(" \"'") for name in re.split(r"[,;\t]", line)]
        plausible = len(names) == len(kind.rows[-1]) > 1 and all(
            re.fullmatch(r"[A-Za-z_][\w ()\[\]/]*", n) for n in names
        )
        if plausible and all(value.continues for value in kind.rows[-1]):
            return names
    return []


def _range_columns(kind: _Kind) -> list[int]:
    """The columns that have a unit of length, or if none has, those whose label says range."""
    row = kind.rows[-1]
    with_unit = [k for k, value in enumerate(row) if value.unit and value.kind != "clock"]
    if with_unit:
        listed = list(with_unit)
        for k in range(with_unit[-1] + 1, len(row)):
            if not (row[k].continues and row[with_unit[-1]].label.rstrip().endswith("[")):
                break
            listed.append(k)
        return listed
    return [k for k, value in enumerate(row) if value.kind in ("number", "word") and _says_range(value)]


def _says_range(value: Value) -> bool:
    """Whether its label says that it is a range, or it is the next in a list."""
    return value.continues or says_range(value.words)


def _nameless(kind: _Kind, columns: Sequence[int], fields: Mapping[int, str]) -> bool:
    """Whether a number stands on the line of which nothing says what it is: a status, another module, a tolerance?"""
    row = kind.rows[-1]
    unnamed_range = any(
        not row[k].words and not row[k].continues and row[k - 1].kind == "number" and k - 1 not in fields
        for k in columns
        if k > 0
    )
    turns = any(k not in fields and _takes_turns(kind.column(k)) for k in range(len(row)))
    return (
        unnamed_range
        or turns
        or any(
            not (value.words or value.unit or value.kind in ("clock", "index") or _UNIT_OF_ITS_OWN.match(value.after))
            for k, value in enumerate(row)
            if k not in fields
        )
    )


def _finest_of_the_same(kind: _Kind, columns: list[int]) -> list[int]:
    """Of columns that say the same length in several units, the one with the finest steps; else all."""
    finest = min(columns, key=lambda column: METRES[kind.rows[-1][column].unit])
    for row in kind.rows:
        lengths = [(row[c].number or 0.0) * METRES[row[c].unit] for c in columns]
        if max(lengths) - min(lengths) > 0.011:
            return columns
    return [finest]


def _add_other_fields(kind: _Kind, fields: dict[int, str]) -> tuple[bool, bool]:
    """Adds time, status and module to `fields`; whether more lines may tell a time, and whether a status is unclear."""
    pending = unclear = False
    for k, value in enumerate(kind.rows[-1]):
        if k in fields:
            continue
        words = set(value.words)
        if value.kind == "index" or _is_module(kind.column(k), words):
            fields[k] = "{module}"
        elif says_status(words):
            codes = Counter(each.text.lower() for each in kind.column(k))
            good = next((code for code in ("0", "true", "1", "0.0") if code in codes), "")
            truth = words & {"valid", "ok"}
            fields[k] = "{status:1}" if truth and good != "true" else "{status}"
            unclear |= not good or (good == "1") != bool(truth and good != "true")
        elif value.kind == "number" and (says_time(words) or not words) and "{time" not in "".join(fields.values()):
            unit = _time_unit(kind.column(k))
            pending |= not unit and len(kind.lines) < ENOUGH_FOR_TIME
            if unit:
                fields[k] = f"{{time:{unit}}}"
    if sum(field == "{module}" for field in fields.values()) > 1:
        for k in [k for k, field in fields.items() if field == "{module}"]:
            del fields[k]
    return pending, unclear


def _is_module(column: list[Value], words: set[str]) -> bool:
    """Whether a column of small whole numbers says which module a line is of: by its place, its name or its turns."""
    if not all(re.fullmatch(r"\d{1,2}", each.text) for each in column):
        return False
    value = column[-1]
    before = re.search(r"[A-Za-z#\[(][ _#\[(]?$", value.label)
    if (before and re.match(r"[\])]?\s*[:=]", value.after)) or says_module(words):
        return True
    return not words and _takes_turns(column)


def _takes_turns(column: list[Value]) -> bool:
    """Whether small whole numbers repeat in the same order."""
    texts = [each.text for each in column]
    turn = len(set(texts))
    small = all(re.fullmatch(r"\d{1,2}", text) for text in texts)
    return small and 1 < turn <= len(texts) // 2 and all(a == b for a, b in zip(texts, texts[turn:], strict=False))


def _is_status(kind: _Kind, column: int, time: int | None) -> bool:
    numbers = [value.number for value in kind.column(column)]
    if column == time or any(number is None or number not in _SMALL_CODES for number in numbers):
        return False
    counted = Counter(numbers)
    return len(counted) <= 4 and counted.most_common(1)[0][1] * 2 >= len(numbers)


def _time_unit(column: Sequence[Value]) -> str:
    """The unit in which a column rises like a time; "" if it does not, or not for long enough."""
    numbers = [value.number for value in column if value.number is not None][-3 * ENOUGH_FOR_TIME :]
    if len(numbers) < min(len(column), ENOUGH_FOR_TIME) or len(numbers) < ENOUGH_FOR_TIME:
        return ""
    steps = sorted(after - before for before, after in pairwise(numbers))
    if len(steps) > 2 * ENOUGH_FOR_TIME:
        steps = steps[1:]  # one restart
    if steps[0] <= 0 or steps[-1] > _UNEVENNESS * steps[0]:
        return ""
    middle = steps[len(steps) // 2]
    return next((unit for unit, (least, most) in _TIME_STEPS.items() if least <= middle <= most), "")


def _pattern(kind: _Kind, fields: dict[int, str], header: Sequence[str] = ()) -> str:
    """The pattern that has these fields, and `{any}` for the other numbers."""
    line, row = kind.lines[-1], kind.rows[-1]
    if header:
        separator = next(mark for mark in (",", ";", "\t") if mark in line)
        return separator.join(fields.get(k, "{number}") for k in range(len(row))).replace("\t", " ")
    _, values = find_values(line)
    text = _literal(values[0].label)
    k = 0
    while k < len(values):
        last = k
        while (
            fields.get(last + 1) == fields.get(k)
            and fields.get(k, "").startswith("{range:")
            and (values[last + 1].continues and "[" in values[k].label)
        ):
            last += 1
        other = values[k].text if values[k].kind == "index" else _skipped(kind.column(k))
        text += fields.get(k, other).replace("{range:", "{ranges:" if last > k else "{range:")
        text += _literal(values[last].after)
        k = last + 1
    return text.strip()


def _skipped(column: Sequence[Value]) -> str:
    """The field that skips a column."""
    return "{number}" if all(value.kind == "number" for value in column) else "{any}"


def _literal(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("{", "{{").replace("}", "}}")


def _quoted(pattern: str) -> str:
    return f"'{pattern}'" if '"' in pattern else f'"{pattern}"'


def _reads(pattern: str, lines: Sequence[str]) -> bool:
    try:
        line_format = LineFormat(pattern, (pattern,))
        return all(isinstance(line_format.read(line), LineReading) for line in lines)
    except InvalidInput:
        return False
