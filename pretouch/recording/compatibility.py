"""Whether a recorded message has fields that this version does not know."""

from __future__ import annotations

from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorSet
from google.protobuf.message import Message

from pretouch.recording.schema import describe_schema

_Field = tuple[str, int, int, int]
"""Full name, number, type and label."""


def find_unknown_fields(described: bytes, message: type[Message]) -> list[str]:
    """Full names of fields in a recorded schema that `message`, or a message nested in it, does not have.

    Args:
        described: the schema as MCAP holds it.

    Raises:
        DecodeError: it is no schema.
    """
    known = describe_schema(message)
    if described == known:
        return []
    root = f".{message.DESCRIPTOR.full_name}"
    recorded = _reachable(_fields(FileDescriptorSet.FromString(described)), root)
    unknown = recorded - _reachable(_fields(FileDescriptorSet.FromString(known)), root)
    return sorted(name for name, *_ in unknown)


def _fields(described: FileDescriptorSet) -> dict[str, DescriptorProto]:
    return {f".{file.package}.{message.name}": message for file in described.file for message in file.message_type}


def _reachable(messages: dict[str, DescriptorProto], root: str) -> set[_Field]:
    """The fields of the message `root`, and of all messages nested in it."""
    found: set[_Field] = set()
    seen, waiting = {root}, [root]
    while waiting:
        name = waiting.pop()
        for field in messages[name].field if name in messages else ():
            found.add((f"{name[1:]}.{field.name}", field.number, field.type, field.label))
            if field.type_name not in seen:
                seen.add(field.type_name)
                waiting.append(field.type_name)
    return found
