"""The fields of contract types, of which JSON, protobuf messages and the OpenAPI description are derived.

A contract type is a frozen dataclass whose docstring describes every field under "Attributes", with unit and frame. A
field is a number, a boolean, a string, a `Pose`, an array of fixed shape such as `Vector3`, a contract type, or a tuple
of these.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable
from functools import cache
from typing import Any, get_type_hints

_ENTRY = re.compile(r"^    (\w+): (.+(?:\n     .+)*)", re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class ContractField:
    """A field of a contract type.

    Attributes:
        name: the same in Python and in JSON, and in small letters in messages.
        type: its type annotation, resolved.
        default: `dataclasses.MISSING` if there is none or it is created anew each time.
        required: whether it has to be given.
        in_json: whether REST has it; messages have all.
        description: its entry under "Attributes", on one line.
    """

    name: str
    type: Any
    default: Any
    required: bool
    in_json: bool
    description: str


def _read_fields(owner: type) -> tuple[ContractField, ...]:
    types = get_type_hints(owner, include_extras=True)
    _, _, attributes = (inspect.getdoc(owner) or "").partition("\nAttributes:\n")
    entries = dict(_ENTRY.findall(attributes.partition("\n\n")[0]))
    return tuple(
        ContractField(
            name=field.name,
            type=types[field.name],
            default=field.default,
            required=field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING,
            in_json=field.metadata.get("json", True),
            description=" ".join(entries.get(field.name, "").split()),
        )
        for field in dataclasses.fields(owner)
    )


contract_fields: Callable[[type], tuple[ContractField, ...]] = cache(_read_fields)
"""The fields of a contract type, in order."""
