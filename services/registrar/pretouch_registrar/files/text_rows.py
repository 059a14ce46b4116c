"""Lines of numbers, with the number of each line so that an error can say where."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from pretouch.errors import Malformed
from pretouch.geometry import Array
from pretouch_registrar.files.shape import cut_short

_NAN = re.compile(r"(?<!\S)[-+]?(?:nan\([^\s)]*\)|1\.#(?:QNAN|SNAN|IND)\d*)(?!\S)", re.IGNORECASE)
_NAN_BYTES = re.compile(_NAN.pattern.encode(), re.IGNORECASE)
"""Not a number as the C libraries of Windows and others write it."""
_WHOLE = re.compile(r"[-+]?\d{1,18}")
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:e[-+]?\d+)?", re.IGNORECASE)


def normalise_line_ends(data: bytes) -> bytes:
    """`data`, with line feeds as line ends, also where it has carriage returns alone."""
    return data if b"\n" in data else data.replace(b"\r", b"\n")


class TextRows:
    """Lines of numbers from byte `at` of the file `name` on; empty lines are skipped."""

    def __init__(self, name: str, data: bytes, at: int = 0) -> None:
        self.name = name
        self._stream = io.BytesIO(data)
        self._stream.seek(at)
        self._size = len(data)
        self.line = data.count(b"\n", 0, at)
        """Number of the line that was read last; the first one is 1."""

    def __iter__(self) -> Iterator[bytes]:
        for line in self._stream:
            self.line += 1
            if not line.isspace():
                yield line

    def words(self, count: int, what: str) -> Iterator[list[str]]:
        """The words of each of the next `count` lines.

        Raises:
            Malformed: fewer lines.
        """
        rows = iter(self)
        for k in range(count):
            row = next(rows, None)
            if row is None:
                raise cut_short(self.name, k, count, what)
            yield row.decode("latin-1").split()

    def columns(self, count: int, columns: list[int], what: str) -> Array:
        """The next `count` lines of numbers: these columns of them, (count, columns).

        Raises:
            Malformed: fewer lines, or one that does not hold numbers.
        """
        if count == 0:
            return np.zeros((0, len(columns)))
        start, line = self._stream.tell(), self.line
        most = min(count, self._size - start)  # the header may announce more than the file holds
        values = self._numbers(most, columns)
        if values is None:
            rest = self._read_from(start, line)
            self._stream = io.BytesIO(_NAN_BYTES.sub(b"nan", rest))
            values = self._numbers(most, columns)
            if values is None:
                self._stream, self.line = io.BytesIO(rest), line
                self._refuse(columns)
        if len(values) < count:
            raise cut_short(self.name, len(values), count, what)
        return values

    def count_remaining(self) -> int:
        """How many lines that are not empty come after those that were read."""
        return sum(1 for _ in self)

    def refuse(self, cause: str, remedy: str = "Write the file again.") -> NoReturn:
        """Raises Malformed for the line that was read last."""
        raise Malformed(f"{self.name}, line {self.line}: {cause}.", remedy)

    def numbers(self, words: list[str]) -> list[float]:
        """`words` of the line that was read last, as numbers.

        Raises:
            Malformed: one is none.
        """
        try:
            return [float(word) for word in words]
        except ValueError:
            return [self._number(word) for word in words]

    def whole_numbers(self, words: list[str]) -> list[int]:
        """The same, as whole numbers."""
        for word in words:
            if not _WHOLE.fullmatch(word):
                self.refuse(f"{word[:40]!r} is no whole number")
        return [int(word) for word in words]

    def polygon(self, words: list[str]) -> list[int]:
        """The corners in `words`, which are behind their number; what follows them is skipped.

        Raises:
            Malformed: fewer corners than it says, or one that is no whole number.
        """
        (count,) = self.whole_numbers(words[:1])
        if not 0 <= count < len(words):
            self.refuse(f"it announces {count} corners and holds {len(words) - 1}")
        return self.whole_numbers(words[1 : 1 + count])

    def _number(self, word: str) -> float:
        try:
            return float(_NAN.sub("nan", word))
        except ValueError:
            self._refuse_word(word)

    def _refuse_word(self, word: str) -> NoReturn:
        """Raises Malformed for a word that is no number."""
        if not word.isprintable():
            self.refuse("it is no text, although the header says so", "Write the file again, as text or as binary.")
        shown = repr(word if len(word) < 40 else word[:40] + "...")
        if _DECIMAL_COMMA.fullmatch(word):
            self.refuse(f"{shown} has a decimal comma", "Export it with decimal points: 0.012, not 0,012.")
        if set(word) & {",", ";"}:
            self.refuse(f"{shown} is no number", "Separate the numbers by blanks.")
        self.refuse(f"{shown} is no number")

    def _numbers(self, most: int, columns: list[int]) -> Array | None:
        """At most `most` rows; None if there is one that cannot be read."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the caller reports that no lines are left
                values = np.loadtxt(iter(self), usecols=columns, max_rows=most, ndmin=2, comments=None)
        except ValueError:
            return None
        return np.asarray(values, dtype=np.float64).reshape(-1, len(columns))

    def _read_from(self, start: int, line: int) -> bytes:
        self.line = line
        self._stream.seek(start)
        return self._stream.read()

    def _refuse(self, columns: list[int]) -> NoReturn:
        """Finds the line that `columns` could not read."""
        for row in self:
            words = row.decode("latin-1").split()
            if max(columns) >= len(words):
                self.refuse(f"it holds {len(words)} numbers where at least {max(columns) + 1} are due")
            self.numbers([words[column] for column in columns])
        raise Malformed(f"{self.name} cannot be read.", "Write the file again.")


def flatten(polygons: list[list[int]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many corners each polygon has, and all of them one after the other."""
    counts = np.array([len(one) for one in polygons], dtype=np.int64)
    return counts, np.array([corner for one in polygons for corner in one], dtype=np.int64)
