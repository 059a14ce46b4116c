"""Commands that packages offer by entry points; each is imported only when it is called.

`pretouch.commands` are those of the command line, `pretouch.session_commands` those of `pretouch session`. An entry's
extra is what must be installed for it.
"""

from __future__ import annotations

import ast
import importlib.util
import os
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import typer

from pretouch.errors import Unavailable

COMMANDS, SESSION_COMMANDS = "pretouch.commands", "pretouch.session_commands"


def add_commands(app: typer.Typer, group: str, called: str | None) -> None:
    """Adds a group's commands to `app`; only the `called` one is imported, the others are there by name."""
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        if entry.name != called:
            app.command(entry.name, help=_summarize(entry))(lambda: None)
            continue
        command = entry.load()
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=entry.name)
        else:
            app.command(entry.name)(command)


def read_called_words() -> list[str | None]:
    """The first two words after the program's name on the command line, or on one that a shell wants completed."""
    line = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS")
    words = sys.argv if line is None or "_PRETOUCH_COMPLETE" not in os.environ else line.split()
    return [*words[1:3], None, None][:2]


def explain_missing(error: ModuleNotFoundError, name: str, extra: str | None) -> Unavailable | ModuleNotFoundError:
    """What to tell the user: the extra to install; `error` itself where none would help."""
    if extra is None or (error.name or "pretouch").startswith("pretouch"):
        return error
    return Unavailable(
        f"{name} needs the package {error.name}, which is not installed.", f"Run: pip install 'pretouch[{extra}]'"
    )


def explain_called(error: ModuleNotFoundError) -> Iterator[Unavailable]:
    """The same for the command that was called, if an extra would help."""
    first, second = read_called_words()
    for group, name in ((COMMANDS, first), (SESSION_COMMANDS, second if first == "session" else None)):
        for entry in entry_points(group=group, name=name or ""):
            explained = explain_missing(error, f"pretouch {entry.name}", next(iter(entry.extras), None))
            if isinstance(explained, Unavailable):
                yield explained


def _summarize(entry: EntryPoint) -> str:
    """The first line of the command's docstring, read without importing its module."""
    spec = importlib.util.find_spec(entry.module)
    if spec is None or spec.origin is None:
        return ""
    module = ast.parse(Path(spec.origin).read_bytes())
    functions = [node for node in module.body if isinstance(node, ast.FunctionDef) and node.name == entry.attr]
    return (ast.get_docstring(functions[0] if functions else module) or "").partition("\n")[0]
