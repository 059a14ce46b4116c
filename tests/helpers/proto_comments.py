"""The comments of the .proto files, which the generated modules do not have."""

from __future__ import annotations

from pathlib import Path

from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorSet
from grpc_tools import protoc

PROTO = Path(__file__).resolve().parents[2] / "proto"


def field_comments(folder: Path) -> dict[str, dict[str, str]]:
    """The comment of each field on one line, by message and name; `folder` takes protoc's output."""
    output = folder / "descriptors.pb"
    files = [str(path) for path in sorted(PROTO.glob("pretouch/v1/*.proto"))]
    command = ["protoc", f"-I{PROTO}", "--include_source_info", f"--descriptor_set_out={output}", *files]
    assert protoc.main(command) == 0
    comments: dict[str, dict[str, str]] = {}
    for file in FileDescriptorSet.FromString(output.read_bytes()).file:
        for location in file.source_code_info.location:
            match list(location.path):
                case [4, message, 2, field]:  # `message_type` of the file, `field` of the message
                    owner: DescriptorProto = file.message_type[message]
                    text = " ".join(location.leading_comments.split())
                    comments.setdefault(owner.name, {})[owner.field[field].name] = text
    return comments
