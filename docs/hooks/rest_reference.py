"""Page reference/rest.md: the REST API from the OpenAPI document that the orchestrator serves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, cast

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pretouch_orchestrator.rest.app import create_rest_app

from pretouch.serving import ServiceContext, Settings

_INTRODUCTION = """# REST

{description}

Made from the OpenAPI document of version {version}. A running orchestrator serves it as `/openapi.json`, and as a page
that needs no internet as `/docs`. Where a token is set (`--token`), every request but `/healthz` and `/readyz` carries
`Authorization: Bearer TOKEN`.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the page."""
    context = ServiceContext("orchestrator", Settings(token="TOKEN"))
    document = create_rest_app(cast(Any, None), context, cast(Any, None)).openapi()
    context.close()
    files.append(File.generated(config, "reference/rest.md", content=render(document)))
    return files


def render(document: dict[str, Any]) -> str:
    """The page of an OpenAPI document."""
    lines = [_INTRODUCTION.format(**document["info"]), "## Endpoints"]
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            lines += _operation(f"{method.upper()} {path}", operation)
    lines.append("## Documents")
    for name, schema in document["components"]["schemas"].items():
        lines += _schema(name, schema)
    return "\n\n".join(lines) + "\n"


def _operation(route: str, operation: dict[str, Any]) -> list[str]:
    lines = [f"### {operation['summary']}", f"`{route}`", operation.get("description", "")]
    parameters = [
        (f"`{p['name']}`", p["in"], _type(p["schema"]), _default(p["schema"]), p.get("description", ""))
        for p in operation.get("parameters", ())
    ]
    if parameters:
        lines.append(_table(("parameter", "in", "type", "default", "meaning"), parameters))
    for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
        lines.append(f"Body, `{media_type}`: {_type(content['schema'])}")
        if "properties" in content["schema"]:
            lines.append(_members(content["schema"]))
    problems = []
    for status, response in operation["responses"].items():
        contents = response.get("content", {})
        if "application/problem+json" in contents:
            problems.append(f"{status} ({response['description'].lower()})")
            continue
        types = "".join(f" `{media}`: {_type(content['schema'])}" for media, content in contents.items())
        lines.append(f"**{status}** {response['description']}{types}")
    if problems:
        lines.append(f"[Problems](errors.md): {', '.join(problems)}.")
    return lines


def _schema(name: str, schema: dict[str, Any]) -> list[str]:
    lines = [f"### {name}", schema.get("description", "")]
    if "properties" in schema:
        lines.append(_members(schema))
    else:
        lines.append(_type(schema))
    for example in schema.get("examples", ()):
        lines.append(f"```json\n{json.dumps(example, indent=2)}\n```")
    return lines


def _members(schema: dict[str, Any]) -> str:
    required = schema.get("required", ())
    rows = [
        (
            f"`{name}`",
            _type(member),
            "required" if name in required else _default(member),
            member.get("description", ""),
        )
        for name, member in schema["properties"].items()
    ]
    return _table(("member", "type", "default", "meaning"), rows)


def _type(schema: dict[str, Any]) -> str:
    """A schema's type in a few words, named ones as links."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for joined in ("anyOf", "oneOf", "allOf"):
        if joined in schema:
            return " or ".join(_type(member) for member in schema[joined])
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    kind = str(schema.get("type", "any"))
    if kind == "array":
        return f"list of {_count(schema)}{_type(schema.get('items', {}))}"
    bounds = [f"{sign} {schema[key]}" for key, sign in _BOUNDS.items() if key in schema]
    return " ".join([schema.get("format", kind), ", ".join(bounds)]).strip()


_BOUNDS = {
    "minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<",
    "minLength": "length ≥", "maxLength": "length ≤", "pattern": "pattern",
}  # fmt: skip


def _count(schema: dict[str, Any]) -> str:
    least, most = schema.get("minItems"), schema.get("maxItems")
    if least is None and most is None:
        return ""
    return f"{least} " if least == most else f"{least or 0} to {'many' if most is None else most} "


def _default(schema: dict[str, Any]) -> str:
    return f"`{json.dumps(schema['default'])}`" if "default" in schema else ""


def _table(heads: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    cells = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(heads), ["---"] * len(heads), *cells])
