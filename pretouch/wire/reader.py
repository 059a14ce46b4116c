"""Reads JSON strictly: every member asked for by name and type, none left over, each error naming the member's path."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from pretouch.errors import InvalidInput, Malformed
from pretouch.geometry import Pose

MAX_INTEGER: Final = 2**31 - 1
_REQUIRED: Final = object()


@contextmanager
def prefix_errors(path: str) -> Iterator[None]:
    """Puts `path` before the detail of an input error raised within."""
    try:
        yield
    except InvalidInput as error:
        raise type(error)(f"{path}: {error.detail}", error.remedy) from error


def name_kind(value: object) -> str:
    """The JSON name of a value's type."""
    names = {dict: "an object", list: "a list", str: "a string", bool: "a boolean", int: "a number", float: "a number"}
    return "null" if value is None else names.get(type(value), type(value).__name__)


def read_number(value: object, path: str) -> float:
    """A finite number.

    Raises:
        InvalidInput: not a number.
        Malformed: not finite.
    """
    if type(value) is not float and type(value) is not int:
        raise InvalidInput(f"{path} is {name_kind(value)}, not a number.", f"Send {path} as a number.")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise Malformed(f"{path} is not a finite number.", f"Send a finite number for {path}.")
    return result


def read_integer(value: object, path: str) -> int:
    """A whole number of at most 31 bits and a sign; 3.0 is one."""
    result = read_number(value, path)
    if not result.is_integer() or abs(result) > MAX_INTEGER:
        raise InvalidInput(f"{path} is {value!r:.40}, not a whole number.", f"Send a whole number for {path}.")
    return int(result)


def read_boolean(value: object, path: str) -> bool:
    """True or false."""
    if type(value) is not bool:
        raise InvalidInput(f"{path} is {name_kind(value)}, not a boolean.", f"Send true or false for {path}.")
    return value


def read_items(value: object, path: str, length: int | None = None) -> list[Any]:
    """A list, of `length` items if given."""
    if type(value) is not list:
        raise InvalidInput(f"{path} is {name_kind(value)}, not a list.", f"Send {path} as a list.")
    if length is not None and len(value) != length:
        raise InvalidInput(f"{path} has {len(value)} items, not {length}.", f"Send {length} items for {path}.")
    return value


def read_numbers(value: object, path: str, length: int) -> list[float]:
    """A list of `length` finite numbers."""
    return [read_number(item, f"{path}[{k}]") for k, item in enumerate(read_items(value, path, length))]


def read_text(value: object, path: str) -> str:
    """A string."""
    if type(value) is not str:
        raise InvalidInput(f"{path} is {name_kind(value)}, not a string.", f"Send {path} as a string.")
    return value


class Members:
    """The members of one JSON object.

    Args:
        value: the parsed JSON.
        path: what the object is called in errors; empty for the whole document.
        known: the names that it may have; None lets any pass, for answers of a newer service.

    Raises:
        InvalidInput: not an object, or with a member that is not in `known`.
    """

    def __init__(self, value: object, path: str, known: tuple[str, ...] | None) -> None:
        if type(value) is not dict:
            name = path or "The document"
            raise InvalidInput(f"{name} is {name_kind(value)}, not an object.", "Send a JSON object.")
        self._value = value
        self._path = path
        unknown = [] if known is None else [name for name in value if name not in known]
        if unknown:
            raise InvalidInput(
                f"{self.path(str(unknown[0])[:80])} is not a known member.", f"Send only {', '.join(known or ())}."
            )

    def __contains__(self, name: str) -> bool:
        return name in self._value

    def path(self, name: str) -> str:
        """What the member `name` is called in errors."""
        return f"{self._path}.{name}" if self._path else name

    def get(self, name: str, default: object = _REQUIRED) -> Any:
        """The member as it is.

        Raises:
            InvalidInput: it is missing and there is no default.
        """
        value = self._value.get(name, default)
        if value is _REQUIRED:
            raise InvalidInput(f"{self.path(name)} is missing.", f"Send {self.path(name)}.")
        return value

    def number(self, name: str) -> float:
        return read_number(self.get(name), self.path(name))

    def integer(self, name: str) -> int:
        return read_integer(self.get(name), self.path(name))

    def numbers(self, name: str, length: int) -> list[float]:
        return read_numbers(self.get(name), self.path(name), length)

    def items(self, name: str) -> list[Any]:
        return read_items(self.get(name), self.path(name))

    def text(self, name: str) -> str:
        return read_text(self.get(name), self.path(name))

    def members(self, name: str, known: tuple[str, ...] | None) -> Members:
        return Members(self.get(name), self.path(name), known)

    def objects(self, name: str) -> list[Members]:
        """A list of JSON objects, which may have any members."""
        return [Members(item, f"{self.path(name)}[{k}]", None) for k, item in enumerate(self.items(name))]

    def pose(self, name: str) -> Pose:
        return read_pose(self.get(name), self.path(name))


def read_pose(value: object, path: str) -> Pose:
    """`{"translation": [x, y, z], "rotation": [x, y, z, w]}`; metres, a unit quaternion."""
    members = Members(value, path, ("translation", "rotation"))
    translation, rotation = members.numbers("translation", 3), members.numbers("rotation", 4)
    with prefix_errors(path):
        return Pose.from_quaternion(translation, rotation)
