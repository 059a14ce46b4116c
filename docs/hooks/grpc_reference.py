"""Page reference/grpc.md: services and messages, from the comments in `proto/`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from grpc_tools import protoc
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

_ROOT = Path(__file__).parents[2]
_FILES = ("orchestrator", "calibrated_camera", "sensor_gateway", "recording", "detector", "registrar", "common")
"""What a robot talks to first, what only services need last."""
_INTRODUCTION = """# gRPC

Made from the comments in `proto/pretouch/v1`. A robot needs the orchestrator, on port 50050, and perhaps the sensor
gateway, on port 50053; detector and registrar serve the orchestrator. All four answer reflection and
`grpc.health.v1.Health`. Where a token is set, every call carries the metadata `authorization: Bearer TOKEN`. A failed
call's trailing metadata `pretouch-problem-bin` holds the [problem document](errors.md).
"""
# Numbers of the members of descriptor.proto, of which a comment's path consists.
_MESSAGES, _ENUMS, _SERVICES, _MEMBERS = 4, 5, 6, 2
_SYNTAX = (12,)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the page."""
    files.append(File.generated(config, "reference/grpc.md", content=render()))
    return files


def render() -> str:
    """The page of all .proto files."""
    described = {Path(file.name).stem: file for file in _compile().file}
    return "\n\n".join([_INTRODUCTION, *(part for name in _FILES for part in _file(name, described[name]))]) + "\n"


def _compile() -> FileDescriptorSet:
    names = [f"pretouch/v1/{name}.proto" for name in _FILES]
    with tempfile.NamedTemporaryFile() as out:
        options = ["--include_source_info", f"--descriptor_set_out={out.name}", f"-I{_ROOT / 'proto'}"]
        if protoc.main(["protoc", *options, *names]) != 0:
            raise RuntimeError("protoc failed")
        return FileDescriptorSet.FromString(Path(out.name).read_bytes())


def _file(name: str, file: FileDescriptorProto) -> Iterator[str]:
    places = file.source_code_info.location
    comments = {tuple(place.path): " ".join(place.leading_comments.split()) for place in places}
    yield f"## {name}.proto\n\n{comments.get(_SYNTAX, '')}"
    for s, service in enumerate(file.service):
        yield f"### {service.name}\n\n{comments.get((_SERVICES, s), '')}"
        rows = [
            f"| `{method.name}` | {_stream(method.client_streaming)}{_link(method.input_type)} "
            f"| {_stream(method.server_streaming)}{_link(method.output_type)} "
            f"| {comments.get((_SERVICES, s, _MEMBERS, m), '')} |"
            for m, method in enumerate(service.method)
        ]
        yield "\n".join(["| method | request | response | meaning |", "| --- | --- | --- | --- |", *rows])
    for m, message in enumerate(file.message_type):
        yield f"### {message.name}\n\n{comments.get((_MESSAGES, m), '')}"
        maps = {nested.name: nested for nested in message.nested_type}
        rows = [
            f"| {field.number} | `{field.name}` | {_type(field, maps)} "
            f"| {comments.get((_MESSAGES, m, _MEMBERS, f), '')} |"
            for f, field in enumerate(message.field)
        ]
        if rows:
            yield "\n".join(["| | field | type | meaning |", "| --- | --- | --- | --- |", *rows])
    for e, enum in enumerate(file.enum_type):
        yield f"### {enum.name}\n\n{comments.get((_ENUMS, e), '')}"
        rows = [
            f"| {value.number} | `{value.name}` | {comments.get((_ENUMS, e, _MEMBERS, v), '')} |"
            for v, value in enumerate(enum.value)
        ]
        yield "\n".join(["| | value | meaning |", "| --- | --- | --- |", *rows])


def _type(field: FieldDescriptorProto, maps: dict[str, DescriptorProto]) -> str:
    """A field's type, messages as links; `maps` are the message's own nested types, which stand for map fields."""
    entry = maps.get(field.type_name.rpartition(".")[2])
    if entry is not None:
        return f"map of {_type(entry.field[0], {})} to {_type(entry.field[1], {})}"
    if field.type_name:
        kind = _link(field.type_name)
    else:
        kind = f"`{FieldDescriptorProto.Type.Name(field.type).removeprefix('TYPE_').lower()}`"
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return f"repeated {kind}"
    if field.proto3_optional:
        return f"optional {kind}"
    return f"{kind}, one of several" if field.HasField("oneof_index") else kind


def _link(type_name: str) -> str:
    name = type_name.rpartition(".")[2]
    return f"[{name}](#{name.lower()})"


def _stream(streaming: bool) -> str:
    return "stream of " if streaming else ""
