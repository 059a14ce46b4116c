"""Page reference/errors.md: the problem types, from the table in `pretouch.errors`."""

from __future__ import annotations

import inspect

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

from pretouch.errors import WIRE

_PAGE, _MARK = "reference/errors.md", "<!-- the table of errors -->"


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Puts the table where the page has its mark."""
    if page.file.src_uri != _PAGE:
        return markdown
    rows = [
        f"| `{wire.slug}` | {wire.http_status} | `{wire.grpc_code.name}` | `{kind.__name__}` "
        f"| {inspect.cleandoc(kind.__doc__ or '').replace(chr(10), ' ')} |"
        for kind, wire in WIRE.items()
    ]
    head = "| `type` ends in | HTTP | gRPC | in Python | when |\n| --- | --- | --- | --- | --- |"
    return markdown.replace(_MARK, "\n".join([head, *rows]))
