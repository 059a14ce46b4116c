"""Structure-aware mutation of protobuf messages: each change leaves a message that can be parsed, but for `spoil`."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message

_LONGEST = 3000
"""Elements that a repeated field grows to."""
_FLOATS = (math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 1e-300, 1e308, -1e308, 1.0, 1000.0, 0.001)
_TEXTS = ("", "\0", ".", "..", "a/b", "é", "x" * 5000, "posterior", "random", "deep", "finger", "scan-1", "%s", "'; --")
_BITS = {
    FieldDescriptor.CPPTYPE_INT32: (31, True),
    FieldDescriptor.CPPTYPE_INT64: (63, True),
    FieldDescriptor.CPPTYPE_UINT32: (32, False),
    FieldDescriptor.CPPTYPE_UINT64: (64, False),
    FieldDescriptor.CPPTYPE_ENUM: (31, True),
}


def mutate(message: Message, chance: random.Random) -> Message:
    """A copy with one to four changes, anywhere in it."""
    copy = type(message)()
    copy.CopyFrom(message)
    for _ in range(chance.randint(1, 4)):
        _change(_choose_place(copy, chance), chance)
    return copy


def spoil(data: bytes, chance: random.Random) -> bytes:
    """A serialised message with a few wrong bytes, too few or too many."""
    spoilt = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(spoilt) + 1)
        match chance.randrange(3):
            case 0:
                spoilt[place : place + 1] = chance.randbytes(1)
            case 1:
                del spoilt[place:]
            case _:
                spoilt[place:place] = chance.randbytes(chance.randint(1, 20))
    return bytes(spoilt)


def _choose_place(message: Message, chance: random.Random) -> Message:
    """`message` or a message in it."""
    inner: list[Message] = []
    for field, value in message.ListFields():
        if field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE:
            inner += value if _is_repeated(field) else [value]
    return _choose_place(chance.choice(inner), chance) if inner and chance.random() < 0.75 else message


def _is_repeated(field: FieldDescriptor) -> bool:
    return bool(field.is_repeated)


def _change(message: Message, chance: random.Random) -> None:
    fields: list[Any] = list(message.DESCRIPTOR.fields)
    if not fields:
        return
    field = chance.choice(fields)
    if chance.random() < 0.15:
        message.ClearField(field.name)
    elif _is_repeated(field):
        _change_list(getattr(message, field.name), field, chance)
    elif field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE:
        getattr(message, field.name).SetInParent()
    else:
        setattr(message, field.name, _draw(field, getattr(message, field.name), chance))


def _change_list(values: Any, field: FieldDescriptor, chance: random.Random) -> None:
    if not values or chance.random() < 0.2:
        if field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE:
            values.add()
        else:
            values.append(_draw(field, field.default_value or _zero(field), chance))
        return
    place = chance.randrange(len(values))
    match chance.randrange(4):
        case 0:
            del values[place]
        case 1:
            copies = min(chance.choice((1, 10, 1000)), max(_LONGEST - len(values), 0))
            values.extend([values[place]] * copies)
        case 2 if field.cpp_type != FieldDescriptor.CPPTYPE_MESSAGE:
            values[place] = _draw(field, values[place], chance)
        case _:
            del values[place:]


def _zero(field: FieldDescriptor) -> Any:
    return {FieldDescriptor.TYPE_STRING: "", FieldDescriptor.TYPE_BYTES: b""}.get(field.type, 0)


def _draw(field: FieldDescriptor, present: Any, chance: random.Random) -> Any:
    """Another value for a field that holds `present`."""
    kind = field.cpp_type
    if kind in _BITS:
        bits, signed = _BITS[kind]
        numbers = (0, 1, 2, 7, 200, 255, 65536, 2**bits - 1, *((-1, -(2**bits)) if signed else ()))
        return chance.choice((*numbers, chance.getrandbits(chance.randint(1, bits))))
    if kind == FieldDescriptor.CPPTYPE_BOOL:
        return not present
    if kind in (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT):
        return chance.choice((*_FLOATS, present * chance.choice((-1, 1000, 0.001)), chance.uniform(-2, 2)))
    if field.type == FieldDescriptor.TYPE_STRING:
        return chance.choice((*_TEXTS, present + "x", present[:-1]))
    changed: list[Callable[[], bytes]] = [
        lambda: b"",
        lambda: present[: len(present) // 2],
        lambda: present + present[:2048],
        lambda: spoil(present, chance),
        lambda: chance.randbytes(len(present) % 4096),
    ]
    return chance.choice(changed)()
