"""A TOML file that gives a command its options."""

from __future__ import annotations

import tomllib
from pathlib import Path

import typer

from pretouch.errors import InvalidInput, Malformed
from pretouch.regular_file import read_regular_file

_MAX_BYTES = 1_000_000


def read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Callback of an option `--config`: the file's values replace the defaults; its keys are the options without `--`.

    Raises:
        NotFound: no such file.
        TooLarge: it has more than a million bytes.
        Malformed: it is not TOML.
        InvalidInput: a key that is no option, or `true` or `false` for an option that is not one of these.
    """
    if path is None:
        return None
    try:
        values = tomllib.loads(read_regular_file(path, _MAX_BYTES).decode())
    except ValueError as error:  # TOML, or the encoding
        raise Malformed(f"{path} is not TOML: {error}.", "Write lines such as rest-port = 8080.") from error
    options = {
        option.removeprefix("--"): parameter
        for parameter in context.command.params
        for option in parameter.opts
        if not getattr(parameter, "hidden", False) and option not in ("--config", "--help", "-h")
    }
    unknown = [key for key in values if key not in options]
    if unknown:
        raise InvalidInput(f"{path} has unknown keys: {', '.join(unknown)}.", f"Known are {', '.join(options)}.")
    context.default_map = {}
    for key, value in values.items():
        if isinstance(value, bool) and not getattr(options[key], "is_flag", False):
            raise InvalidInput(f"{path}: {key} is {str(value).lower()}, which is no value for it.", "Write its value.")
        several = getattr(options[key], "multiple", False) and not isinstance(value, list)
        context.default_map[str(options[key].name)] = [value] if several else value
    return path
