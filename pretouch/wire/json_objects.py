"""Contract types <-> JSON objects, field by field: see `pretouch.wire.contract`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_origin

import numpy as np

from pretouch.geometry import Pose
from pretouch.rectangle import RotatedRectangle
from pretouch.wire.contract import contract_fields
from pretouch.wire.reader import (
    Members,
    read_boolean,
    read_integer,
    read_items,
    read_number,
    read_numbers,
    read_pose,
    read_text,
)

_Owner = TypeVar("_Owner")
_READERS: dict[Any, Callable[[object, str], Any]] = {
    float: read_number,
    int: read_integer,
    bool: read_boolean,
    str: read_text,
    Pose: read_pose,
    RotatedRectangle: lambda value, path: RotatedRectangle(*read_numbers(value, path, 5)),
}


def pose_to_json(pose: Pose) -> dict[str, Any]:
    return {"translation": pose.translation.tolist(), "rotation": pose.quaternion.tolist()}


def object_to_json(value: Any) -> dict[str, Any]:
    """The JSON object of a contract type."""
    return {
        field.name: _value_to_json(getattr(value, field.name))
        for field in contract_fields(type(value))
        if field.in_json
    }


def object_from_json(members: Members, owner: type[_Owner]) -> _Owner:
    """The contract type `owner` from its JSON object; members left out take their defaults.

    Raises:
        InvalidInput: a missing member, a wrong type or length, a value out of its limits.
        Malformed: a number that is not finite.
    """
    given = {
        field.name: _value_from_json(members.get(field.name), field.type, members.path(field.name))
        for field in contract_fields(owner)
        if field.in_json and (field.required or field.name in members)
    }
    return owner(**given)


def names_in_json(owner: type) -> tuple[str, ...]:
    """The names that a client may send in the JSON object of `owner`."""
    return tuple(field.name for field in contract_fields(owner) if field.in_json)


def _value_to_json(value: Any) -> Any:
    match value:
        case Pose():
            return pose_to_json(value)
        case RotatedRectangle():
            return value.as_list()
        case np.ndarray():
            return value.tolist()
        case tuple():
            return [_value_to_json(item) for item in value]
        case _:
            return object_to_json(value) if is_dataclass(value) else value


def _value_from_json(value: object, wanted: Any, path: str) -> Any:
    if get_origin(wanted) is tuple:
        kind = get_args(wanted)[0]
        return tuple(_value_from_json(item, kind, f"{path}[{k}]") for k, item in enumerate(read_items(value, path)))
    if get_origin(wanted) is Annotated:
        shape = wanted.__metadata__[0]
        return np.array(_read_array(value, shape, path)).reshape([-1 if length is None else length for length in shape])
    if type(None) in get_args(wanted):
        return None if value is None else _value_from_json(value, get_args(wanted)[0], path)
    if wanted in _READERS:
        return _READERS[wanted](value, path)
    return object_from_json(Members(value, path, None), wanted)


def _read_array(value: object, shape: tuple[int | None, ...], path: str) -> Any:
    """Nested lists of `shape`, of which None stands for any length."""
    length, *rest = shape
    if not rest:
        return [read_number(item, f"{path}[{k}]") for k, item in enumerate(read_items(value, path, length))]
    return [_read_array(row, tuple(rest), f"{path}[{k}]") for k, row in enumerate(read_items(value, path, length))]
