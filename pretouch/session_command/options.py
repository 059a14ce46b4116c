"""What all commands share: the session's id, where the orchestrator is, and what is written to."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from pretouch.client.http import REST_ADDRESS
from pretouch.results import STANDARD_OUTPUT

DEFAULT_URL = REST_ADDRESS
_WIDE = 160
"""Columns where nobody says how many there are: a line of a table is then found whole by grep."""

SessionId = Annotated[str, typer.Argument(metavar="SESSION", help="The session's id.")]
Url = Annotated[str, typer.Option(help="The orchestrator's REST address.")]
Json = Annotated[
    Path | None,
    typer.Option("--json", help="Where it goes as JSON; - is standard output.", show_default=False),
]


def open_console(json: Path | None = None) -> Console:
    """What people read goes to standard output, or to standard error where JSON takes that place.

    Text is shown as it is: nothing in a name or message is taken for markup.
    """
    console = Console(stderr=json == STANDARD_OUTPUT, highlight=False, markup=False, emoji=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _WIDE
    return console


def print_paragraphs(console: Console, paragraphs: Iterable[Text]) -> None:
    """Each wrapped between words in a terminal, and in one line elsewhere."""
    for text in paragraphs:
        console.print(text, soft_wrap=not console.is_terminal)
