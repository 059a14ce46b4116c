"""Finds the numbers on a line of text, and what is written around each."""

from __future__ import annotations

import re
from dataclasses import dataclass

_VALUE = re.compile(
    r"""(?P<clock>(?<![\w.:])\d{1,2}:\d{2}:\d{2}(?:[.,]\d{1,6})?(?![\w:]))
    |(?P<index>(?<=[A-Za-z_])\d{1,2}(?=\W{0,2}\s*[:=]))
    |(?P<comma>(?<![\w.])[+-]?\d+,\d+(?=\s*(?:mm|cm|m)(?![A-Za-z])))
    |(?P<number>(?<![\w.])(?:[+-](?=[\d.]))?(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?(?=[A-Za-z]{0,6}(?![\w.])))
    |(?P<word>(?<!\w)(?:nan|none|null|true|false|[+-]?inf(?:inity)?)(?!\w))""",
    re.IGNORECASE | re.VERBOSE,
)
_UNITS = {"mm": "mm", "cm": "cm", "m": "m", "millimet": "mm", "centimet": "cm", "met": "m"}
_UNIT = r"(mm|cm|m|millimet(?=(?:er|re)s?\b)|centimet(?=(?:er|re)s?\b)|met(?=(?:er|re)s?\b))(?:ers?|res?)?"
_UNIT_AFTER = re.compile(rf"^\s*{_UNIT}(?![\w/²^])", re.IGNORECASE)
_UNIT_BEFORE = re.compile(rf"(?:^|[\W_]){_UNIT}[\])\"']*\s*[:=]?\s*[\"']?\[?\s*$", re.IGNORECASE)
_SEPARATOR = re.compile(r"\s*[,;]?\s*")


@dataclass(frozen=True)
class Value:
    """A number, or a word in a number's place.

    Attributes:
        kind: "number", "comma" (a number that may have a decimal comma), "word", "clock" (hours:minutes:seconds) or
            "index" (digits at the end of a name).
        label: what is written before it, since the number before, with the index of its name; after: what is written
            until the next.
        unit: mm, cm or m, if one is written beside it; else "".
    """

    kind: str
    text: str
    label: str
    after: str
    unit: str

    @property
    def words(self) -> tuple[str, ...]:
        """The words of its label in small letters, without the unit of the number before it."""
        return tuple(
            word.lower()
            for word in re.findall(
                r"[A-Za-z][A-Za-z\d]*?(?=\d*(?![A-Za-z\d]))", re.split(r"[,;\t|]", self._own_label)[-1]
            )
        )

    @property
    def number(self) -> float | None:
        """Its value; None for a word or a clock."""
        return float(self.text) if self.kind in ("number", "index") else None

    @property
    def continues(self) -> bool:
        """Whether only a separator stands between it and the number before."""
        return _SEPARATOR.fullmatch(self._own_label) is not None

    @property
    def _own_label(self) -> str:
        """Its label without the unit of the number before it."""
        match = _UNIT_AFTER.match(self.label)
        return self.label[match.end() :] if match else self.label


@dataclass(frozen=True)
class Template:
    """What lines of one kind have in common: all but their numbers."""

    literals: tuple[str, ...]
    kinds: tuple[str, ...]


def find_values(line: str) -> tuple[Template, list[Value]]:
    """The numbers on a line, and the rest of it."""
    matches = list(_VALUE.finditer(line))
    edges = [0, *(match.end() for match in matches)]
    starts = [*(match.start() for match in matches), len(line)]
    literals = [line[edge:start] for edge, start in zip(edges, starts, strict=True)]
    values: list[Value] = []
    for k, match in enumerate(matches):
        named = values[-1] if values and values[-1].kind == "index" else None
        label = literals[k] if named is None else f"{named.label}{named.text}{literals[k]}"
        unit = _unit(literals[k], literals[k + 1], k == 0)
        values.append(Value(str(match.lastgroup), match[0], label, literals[k + 1], unit))
    kinds = tuple("number" if value.kind in ("word", "comma") else value.kind for value in values)
    return Template(tuple(re.sub(r"\s+", " ", each) for each in literals), kinds), values


def _unit(before: str, after: str, is_first: bool) -> str:
    """The unit of a number, beside it; one that directly follows the number before is that one's."""
    own = before if is_first else _UNIT_AFTER.sub("", before, count=1)
    match = _UNIT_AFTER.match(after) or _UNIT_BEFORE.search(own)
    return _UNITS[match[1].lower()] if match else ""
