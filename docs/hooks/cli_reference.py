"""Page reference/cli.md: every command and option, from the command line's own help."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib.metadata import entry_points
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from pretouch.cli import _app
from pretouch.commands import SESSION_COMMANDS

_INTRODUCTION = """# Commands and options

Every command and option, made from the help that `pretouch COMMAND --help` shows. Options with an environment variable
take it where they are not given. What all commands have in common is on its [own page](command-line.md).
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the page."""
    files.append(File.generated(config, "reference/cli.md", content=render()))
    return files


def render() -> str:
    """The page of the whole command line, with the commands of all packages."""
    root = _group(_app(None))
    commands = dict(root.commands)
    for entry in entry_points(group="pretouch.commands"):
        commands[entry.name] = _group(_app(entry.name)).commands[entry.name]
    for entry in entry_points(group=SESSION_COMMANDS):
        alone = typer.Typer()
        alone.command(entry.name)(entry.load())
        commands["session"].commands[entry.name] = _group(alone)
    sections = [section for name in sorted(commands) for section in _sections(f"pretouch {name}", commands[name])]
    return "\n\n".join([_INTRODUCTION, root.epilog or "", *sections]) + "\n"


def _group(app: typer.Typer) -> Any:
    return typer.main.get_command(app)


def _sections(path: str, command: Any) -> Iterator[str]:
    """A command's section, then those of its subcommands."""
    if hasattr(command, "commands"):
        for name in sorted(command.commands):
            yield from _sections(f"{path} {name}", command.commands[name])
        return
    yield f"## {path}"
    yield inspect.cleandoc(command.help or "")
    context = command.make_context(path, [], resilient_parsing=True)
    yield f"```\n{' '.join([path, *command.collect_usage_pieces(context)])}\n```"
    records = [parameter.get_help_record(context) for parameter in command.params]
    rows = [f"| `{names}` | {_cell(meaning)} |" for names, meaning in filter(None, records)]
    if rows:
        yield "\n".join(["| option | meaning |", "| --- | --- |", *rows])


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("[", "\\[").replace("\n", " ")
