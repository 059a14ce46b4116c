"""A message's schema as MCAP files hold it."""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message


def describe_schema(message: type[Message]) -> bytes:
    """The schema of a message as MCAP requires it: a FileDescriptorSet of its file and all that this imports."""
    return _describe_file(message.DESCRIPTOR.file)


@cache
def _describe_file(file: Any) -> bytes:
    files: dict[str, Any] = {}

    def add(one: Any) -> None:
        if one.name not in files:
            for imported in one.dependencies:
                add(imported)
            files[one.name] = one

    add(file)
    described = FileDescriptorSet()
    for each in files.values():
        each.CopyToProto(described.file.add())
    return described.SerializeToString()
