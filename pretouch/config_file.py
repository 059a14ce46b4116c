"""A TOML file that gives a command its options."""

from __future__ import annotations

import tomllib
from pathlib import Path

import typer

from pretouch.errors import InvalidInput, Malformed, NotFound


def read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Callback of an option `--config`: the file's values replace the defaults; its keys are the options without `--`.

    Raises:
        NotFound: no such file.
        Malformed: it is not TOML.
        InvalidInput: a key that is no option.
    """
    if path is None:
        return None
    try:
        values = tomllib.loads(path.read_text())
    except OSError as error:
        raise NotFound(f"{path} cannot be read: {error.strerror}.", "Check the path.") from error
    except ValueError as error:  # TOML, or the encoding
        raise Malformed(f"{path} is not TOML: {error}.", "Write lines such as rest-port = 8080.") from error
    options = {
        option.removeprefix("--"): parameter
        for parameter in context.command.params
        for option in parameter.opts
        if option not in ("--config", "--help", "-h")
    }
    unknown = [key for key in values if key not in options]
    if unknown:
        raise InvalidInput(f"{path} has unknown keys: {', '.join(unknown)}.", f"Known are {', '.join(options)}.")
    context.default_map = {}
    for key, value in values.items():
        several = getattr(options[key], "multiple", False) and not isinstance(value, list)
        context.default_map[str(options[key].name)] = [value] if several else value
    return path
