"""A message's schema as MCAP files hold it."""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message


def describe_schema(message: type[Message]) -> bytes:
    """The schema of a message as MCAP requires it: a FileDescriptorSet of its file and all that this imports."""
    return _describe_file(message.DESCRIPTOR.file)


@cache
def _describe_file(described: FileDescriptor) -> bytes:
    files: dict[str, Any] = {}

    def add(file: Any) -> None:
        if file.name not in files:
            for imported in file.dependencies:
                add(imported)
            files[file.name] = file

    add(described)
    whole = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(whole.file.add())
    return whole.SerializeToString()
