"""Line patterns: what a user writes, or a preset holds, to say where on a line ranges, times and status stand.

    {time:ms},{range:mm},{status}          a CSV line
    Ambient: {any} Range: {range:mm}       labels are compared without regard to case and blanks
    {time:us} {ranges:mm}                  as many ranges as the line has, between blanks, commas or semicolons
    [{time:hms}, {sequence}]( {range:mm} [{status}])+        ( .. )+ is repeated, ( .. )? may be missing

Fields: `range`, `ranges` with a unit mm, cm or m ("{range:cm,}": with a decimal comma); `time` with s, ms, us or hms
(hours:minutes:seconds); `status`, with the codes that are good if these are not 0: {status:5|9}; `module`, the name of
the module that the line is of; `sequence`; `pending`, a hexadecimal mask of modules that did not answer; `number` and
`any` are skipped. All of a line must match; `{any}` at the end takes the rest. A blank between two fields stands for
blanks, a comma or a semicolon. `{{` and `}}` are braces.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

from pretouch.errors import InvalidInput
from pretouch_sensor_gateway.wire_formats.range_text import METRES, NUMBER, UNIT_NAMES, RangeText

TIME_UNITS = {"s": 1e6, "ms": 1e3, "us": 1.0, "hms": 1e6}
"""The units of times, in microseconds; `hms` is hours:minutes:seconds."""
SEPARATOR = r"(?:[ \t]*[,;][ \t]*|[ \t]+)"
"""What a blank between two fields stands for, and what is between the numbers of `{ranges}`."""

_FIELD = re.compile(r"\{(\w+)(?::([^{}]*))?\}")
_FIELDS = ("time", "range", "ranges", "status", "module", "sequence", "pending", "number", "any")
_LIST = r"[-+.,;\w \t/]*"
_STATUS = r"range valid, [\w ]{5,20}|-?\d{1,5}|\(?[A-Za-z][\w /-]{0,40}\)?"
_TIME_SUFFIX = {"s": r"s|sec", "ms": "ms", "us": "us", "hms": "s"}
_MOST_SKIPS = 3
"""`{any}` before the end: a line that almost matches takes time that grows with the power of their number."""
_EXAMPLE = "Write for instance {time:ms},{range:mm} or Distance: {range:cm}: see docs/reference/wire-formats.md."


@dataclass(frozen=True)
class Field:
    """A field of a pattern, and what is written after its colon."""

    kind: str
    argument: str = ""


@dataclass(frozen=True)
class Group:
    """The part of a pattern that is repeated: its expression and the fields in it."""

    expression: re.Pattern[str]
    fields: tuple[Field, ...]
    kind = "group"
    argument = ""


@dataclass(frozen=True)
class LinePattern:
    """A compiled pattern.

    Attributes:
        text: as it was written.
        expression: matches a whole line; each of its groups is one of `fields`.
        fields: in the order of the expression's groups; a `Group` matches all its repetitions together.
        unit: of the ranges.
    """

    text: str
    expression: re.Pattern[str]
    fields: tuple[Field | Group, ...]
    unit: str

    @cached_property
    def plain(self) -> bool:
        """Whether it has only ranges, and perhaps a time."""
        return all(each.kind in ("range", "ranges", "time") for each in self.fields)

    @property
    def time_unit(self) -> str | None:
        """The unit of its time; None if it has none."""
        return next((each.argument for each in self.fields if isinstance(each, Field) and each.kind == "time"), None)


def unit_of(text: str) -> str:
    """The unit of the ranges in a pattern.

    Raises:
        InvalidInput: it has no range, no unit, or two.
    """
    units = {match[2] for match in _FIELD.finditer(text) if match[1] in ("range", "ranges")}
    if not units:
        raise InvalidInput(f"The format {text!r} has no range.", _EXAMPLE)
    stated = {unit.removesuffix(",") if unit else "" for unit in units}
    if len(stated) > 1:
        raise InvalidInput(f"The format {text!r} has ranges in several units.", "Give all ranges the same unit.")
    (unit,) = stated
    if unit not in METRES:
        raise InvalidInput(f"The format {text!r} has a range in {unit or 'no unit'}.", "Write mm, cm or m: {range:mm}.")
    return unit


def compile_pattern(text: str, ranges: RangeText, exact: bool = False) -> LinePattern:
    """Compiles a pattern.

    Args:
        exact: blanks on the line must stand where they stand in the pattern.

    Raises:
        InvalidInput: the pattern cannot be understood; the remedy shows one that can.
    """
    unit = unit_of(text)
    compiler = _Compiler(text, ranges, exact)
    expression = compiler.compile(text)
    kinds = [each.kind for each in compiler.fields if isinstance(each, Field)]
    for kind in ("time", "ranges", "module", "sequence", "pending"):
        if kinds.count(kind) > 1:
            raise InvalidInput(f"The format {text!r} has {{{kind}}} twice.", _EXAMPLE)
    if compiler.skips > _MOST_SKIPS:
        raise InvalidInput(
            f"The format {text!r} has {{any}} {compiler.skips} times.", "Write {number} for what is always a number."
        )
    if "ranges" in kinds and ("range" in kinds or any(isinstance(each, Group) for each in compiler.fields)):
        raise InvalidInput(f"The format {text!r} has {{ranges}} beside other ranges.", _EXAMPLE)
    end = r"\s*[,;]?\s*" if "ranges" in kinds else r"\s*"
    return LinePattern(text, re.compile(rf"\s*{expression}{end}", re.IGNORECASE), tuple(compiler.fields), unit)


class _Compiler:
    """Compiles a pattern and its parts.

    Attributes:
        fields: so far.
        skips: `{any}` so far, but for one at the end.
    """

    def __init__(self, whole: str, ranges: RangeText, exact: bool) -> None:
        self.fields: list[Field | Group] = []
        self.skips = 0
        self._whole = whole
        self._ranges = ranges
        self._exact = exact

    def compile(self, text: str) -> str:
        """The regular expression of a part; adds its fields to `fields`."""
        parts: list[tuple[str, str]] = []  # kind ("word", "mark", "blank", "field", "range", "group") and expression
        at = 0
        while at < len(text):
            end, kind, expression = self._next(text, at)
            if kind == "word" and self._is_unit(parts, text[at:end]):
                while parts.pop()[0] != "range":
                    pass
                # a unit after a range is part of the range, and must be there
                argument = str(getattr(self.fields[-1], "argument", ""))
                parts.append(("range", f"({self._ranges.pattern(argument.endswith(','), with_unit=True)})"))
            else:
                parts.append((kind, expression))
            at = end
        return self._join(parts)

    def _next(self, text: str, at: int) -> tuple[int, str, str]:
        if text.startswith(("{{", "}}"), at):
            return at + 2, "mark", re.escape(text[at])
        if match := _FIELD.match(text, at):
            last = not text[match.end() :].strip()
            expression = self._field(match[1], match[2] or "", last)
            if match[1] == "range" and (
                text[at - 1 : at] in (",", ";") or text[match.end() : match.end() + 1] in (",", ";")
            ):
                expression = f"{expression[:-1]}|)"  # a cell of a table may be empty
            return match.end(), "range" if match[1] == "range" else "field", expression
        if text[at] in "{}":
            raise InvalidInput(f"The format {self._whole!r} has a brace that is no field.", _EXAMPLE)
        if text[at] == "(" and (end := _closing(text, at)) is not None:
            return end + 2, "group", self._group(text[at + 1 : end], text[end + 1])
        if text[at].isspace():
            end = at + len(text[at:]) - len(text[at:].lstrip())
            return end, "blank", ""
        if text[at].isalnum():
            match = re.compile(r"[^\W_]+").match(text, at)
            assert match is not None
            return match.end(), "word", re.escape(match[0])
        return at + 1, "mark", re.escape(text[at])

    def _is_unit(self, parts: list[tuple[str, str]], word: str) -> bool:
        """Whether `word` is the unit of the range that stands directly before it."""
        last = next((kind for kind, _ in reversed(parts) if kind != "blank"), "")
        return last == "range" and re.fullmatch(UNIT_NAMES[self._ranges.unit], word, re.I) is not None

    def _field(self, kind: str, argument: str, last: bool) -> str:
        if kind not in _FIELDS:
            known = ", ".join(f"{{{name}}}" for name in _FIELDS)
            raise InvalidInput(f"The format {self._whole!r} has the field {{{kind}}}.", f"Fields are {known}.")
        if kind == "any" and last:
            return ".*"
        if kind == "any":
            self.skips += 1
            return r"[^,;\t]{0,80}?"
        if kind == "number":
            return rf"(?:{NUMBER}|nan|inf)"
        if kind == "time" and argument not in TIME_UNITS:
            raise InvalidInput(
                f"The format {self._whole!r} has a time in {argument or 'no unit'}.",
                "Write s, ms, us or hms: {time:ms}.",
            )
        self.fields.append(Field(kind, argument))
        return f"({self._expression(kind, argument)})"

    def _expression(self, kind: str, argument: str) -> str:
        match kind:
            case "range":
                return self._ranges.pattern(argument.endswith(","))
            case "ranges":
                return _LIST
            case "time" if argument == "hms":
                return r"\d{1,6}:[0-5]?\d:[0-5]?\d(?:[.,]\d{1,6})?"
            case "time":
                return rf"\d{{1,18}}(?:\.\d{{0,9}})?(?:\s*(?:{_TIME_SUFFIX[argument]})\b)?"
            case "status":
                return _STATUS
            case "module":
                return r"[\w .-]{0,40}?\w"
            case "sequence":
                return r"\d{1,10}"
            case _:
                return r"[0-9A-F]{1,16}"

    def _group(self, content: str, mark: str) -> str:
        if mark == "?":
            return f"(?:{self.compile(content)})?"
        inner = _Compiler(self._whole, self._ranges, self._exact)
        expression = inner.compile(content)
        self.skips += inner.skips
        fields = tuple(each for each in inner.fields if isinstance(each, Field))
        if len(fields) < len(inner.fields) or not any(each.kind == "range" for each in fields):
            raise InvalidInput(f"The format {self._whole!r} repeats a part without a range, or twice.", _EXAMPLE)
        self.fields.append(Group(re.compile(expression, re.IGNORECASE), fields))
        return f"((?:{re.sub(_CAPTURING, '(?:', expression)})+)"

    def _join(self, parts: list[tuple[str, str]]) -> str:
        """One expression: lenient with blanks beside punctuation marks, unless the pattern is exact."""
        joined = ""
        for k, (kind, expression) in enumerate(parts):
            before = parts[k - 1][0] if k else ""
            after = parts[k + 1][0] if k + 1 < len(parts) else ""
            if kind == "blank":
                joined += self._blank(before, after)
            elif self._exact or kind != "mark":
                joined += expression
            else:
                joined += ("" if before in ("blank", "mark") else r"\s*") + expression
                joined += "" if after == "blank" else r"\s*"
        return joined

    def _blank(self, before: str, after: str) -> str:
        if self._exact:
            return r"\s+"
        if before in _FIELD_PARTS and after in _FIELD_PARTS:
            return SEPARATOR
        if "mark" in (before, after) or not before or not after or "group" in (before, after):
            return r"\s*"
        return r"\s+"


_FIELD_PARTS = ("field", "range")
_CAPTURING = re.compile(r"(?<!\\)\((?!\?)")
"""An opening parenthesis that captures, in an expression of this module, which has none in a character class."""


def _closing(text: str, start: int) -> int | None:
    """Where the group that opens at `start` closes; None if this parenthesis is only a character of the line."""
    depth = 0
    for at in range(start, len(text)):
        depth += (text[at] == "(") - (text[at] == ")")
        if depth == 0:
            return at if text[at + 1 : at + 2] in ("?", "+") else None
    return None
