"""Derives models of JSON documents from contract types: see `pretouch.wire.contract`."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Collection
from types import GenericAlias
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, create_model
from pydantic.json_schema import SkipJsonSchema

from pretouch import geometry
from pretouch.rectangle import RotatedRectangle
from pretouch.wire.contract import contract_fields

LeftOut = SkipJsonSchema[None]
"""Makes a member one that may be left out, but must not be null."""


def optional_field(description: str) -> Any:
    """A member of a type that includes `LeftOut`."""
    return Field(None, description=description, json_schema_extra=_hide_default)


def _hide_default(schema: dict[str, Any]) -> None:
    del schema["default"]


class StrictModel(BaseModel):
    """A document sent by clients: other members than these are refused."""

    model_config = ConfigDict(extra="forbid")


class Pose(StrictModel):
    """A rigid transform `a_T_b`: maps a point in b to a; the member that holds it names the frames."""

    translation: Annotated[list[float], Field(min_length=3, max_length=3)] = Field(
        description="Translation (x, y, z) in the axes of a, in metres.", examples=[[0.45, 0.0, 0.3]]
    )
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)] = Field(
        description="Unit quaternion (x, y, z, w), without unit; its norm is within 1e-3 of 1.",
        examples=[[0.0, 0.0, 0.0, 1.0]],
    )


_MODELS: dict[Any, Any] = {
    geometry.Pose: Pose,
    RotatedRectangle: Annotated[list[float], Field(min_length=5, max_length=5)],
}
"""What a type is in JSON; `derive_model` adds what it derives."""


def derive_model(owner: type, base: type[BaseModel], without: Collection[str] = (), **types: Any) -> type[BaseModel]:
    """The model of the JSON object of a contract type.

    Args:
        base: `StrictModel` if clients send it: fields with a default may then be left out. Else all are there.
        without: names of fields that JSON has elsewhere.
        types: types of members that are narrower than, or different from, those of the fields.
    """
    members: dict[str, Any] = {}
    for field in contract_fields(owner):
        if not field.in_json or field.name in without:
            continue
        kind = types.get(field.name) or _json_type(field.type)
        description = field.description[:1].upper() + field.description[1:]
        if not field.required and base is StrictModel and field.default is dataclasses.MISSING:
            kind = kind | LeftOut
        if LeftOut in get_args(kind):
            members[field.name] = kind, optional_field(description)
        elif field.required or base is not StrictModel:
            members[field.name] = kind, Field(description=description)
        else:
            members[field.name] = kind, Field(field.default, description=description)
    summary = (inspect.getdoc(owner) or "").partition("\n\n")[0]
    model = create_model(owner.__name__, __base__=base, __doc__=" ".join(summary.split()), **members)
    _MODELS[owner] = model
    return model


def extend_model(model: type[BaseModel], **members: Any) -> type[BaseModel]:
    """The same model with further members, each a type and a `Field`."""
    return create_model(model.__name__, __base__=model, __doc__=model.__doc__, **members)


def _json_type(kind: Any) -> Any:
    arguments = get_args(kind)
    if get_origin(kind) is tuple:
        return GenericAlias(list, (_json_type(arguments[0]),))
    if get_origin(kind) is Annotated:
        result: Any = float
        for length in reversed(kind.__metadata__[0]):
            result = GenericAlias(list, (result,))
            if length is not None:
                result = Annotated[result, Field(min_length=length, max_length=length)]
        return result
    if type(None) in arguments:
        return _json_type(arguments[0]) | LeftOut
    return _MODELS.get(kind, kind)
