"""Renders the OpenAPI document as a self-contained HTML page, because robots often have no internet access."""

from __future__ import annotations

import json
from base64 import b64encode
from hashlib import sha256
from html import escape
from typing import Any

STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 56rem; margin: 2rem auto; padding: 0 1rem; }
body { overflow-wrap: anywhere; color: #1b1b1f; background: #fff; } a { color: #00528a; }
@media (prefers-color-scheme: dark) { body { color: #ececf1; background: #16161a; } a { color: #8ecbff; } }
section { border-top: 1px solid #8886; padding: .5rem 0; }
code, pre { font: 14px/1.4 ui-monospace, monospace; }
pre { overflow-x: auto; background: #8881; padding: .75rem; }
.method { display: inline-block; min-width: 4.5rem; font-weight: bold; }
td { vertical-align: top; min-width: 6rem; padding: .15rem 1rem .15rem 0; }
h2 { font-size: 1.1rem; }
"""
PAGE_POLICY = (
    f"default-src 'none'; style-src 'sha256-{b64encode(sha256(STYLE.encode()).digest()).decode('ascii')}'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
"""The content security policy of a page without scripts whose only style is STYLE."""


def render_docs_page(document: dict[str, Any]) -> str:
    """The page of an OpenAPI document."""
    info = document["info"]
    operations = "".join(
        _render_operation(method, path, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    )
    schemas = "".join(_render_schema(name, schema) for name, schema in document["components"]["schemas"].items())
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{escape(info['title'])} API</title>"
        f"<meta name='viewport' content='width=device-width'><style>{STYLE}</style>"
        f"<h1>{escape(info['title'])} {escape(info['version'])}</h1><p>{escape(info['description'])}</p>"
        f"<p>For programs: <a href='/openapi.json'>/openapi.json</a>.</p>{operations}<h2>Documents</h2>{schemas}</html>"
    )


def _render_operation(method: str, path: str, operation: dict[str, Any]) -> str:
    parameters = "".join(
        _render_row(f"{parameter['name']} ({parameter['in']})", parameter.get("description", ""))
        for parameter in operation.get("parameters", ())
    )
    body = "".join(
        _render_row(f"body {media_type}", _describe_schema(content["schema"]))
        for media_type, content in operation.get("requestBody", {}).get("content", {}).items()
    )
    responses = "".join(
        _render_row(status, f"{response['description']} {_describe_contents(response)}")
        for status, response in operation["responses"].items()
    )
    return (
        f"<section><h2><code><span class='method'>{method.upper()}</span>{escape(path)}</code></h2>"
        f"<p>{escape(operation.get('description') or operation.get('summary', ''))}</p>"
        f"<table>{parameters}{body}{responses}</table></section>"
    )


def _describe_contents(response: dict[str, Any]) -> str:
    return ", ".join(
        f"{media_type}: {_describe_schema(content['schema'])}"
        for media_type, content in response.get("content", {}).items()
    )


def _describe_schema(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "properties" in schema:
        return ", ".join(f"{name}: {_describe_schema(member)}" for name, member in schema["properties"].items())
    return str(schema.get("format") or schema.get("type", ""))


def _render_row(name: str, meaning: str) -> str:
    return f"<tr><td><code>{escape(name)}</code></td><td>{escape(meaning)}</td></tr>"


def _render_schema(name: str, schema: dict[str, Any]) -> str:
    text = escape(json.dumps(schema, indent=2))
    return f"<details><summary><code>{escape(name)}</code></summary><pre>{text}</pre></details>"
