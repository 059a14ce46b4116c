"""Files that commands write: checked before the work begins, replaced whole, and `-` for standard output.

`--json PATH` means the same in every command: one JSON document goes to PATH, or to standard output if PATH is `-`;
what is said for people then goes to standard error.
"""

from __future__ import annotations

import errno
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from pretouch.errors import InvalidInput, Unavailable

STANDARD_OUTPUT = Path("-")


def check_file(path: Path) -> None:
    """Makes the folder of `path`, and makes sure that `path` can be written.

    Raises:
        InvalidInput: it cannot.
    """
    if path == STANDARD_OUTPUT:
        return
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "it is a folder")
        if not _is_special(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        if path.is_fifo():
            raise OSError(errno.EINVAL, "it is a pipe")
        if len(os.fsencode(path.name)) > 255:
            raise OSError(errno.ENAMETOOLONG, "its name is too long")
        if path.exists() and not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, "it may not be changed")
    except OSError as error:
        raise _cannot_be_written(path, error) from error


def check_folder(path: Path) -> None:
    """Makes the folder `path`, and makes sure that files can be written into it.

    Raises:
        InvalidInput: they cannot.
    """
    try:
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "it is not a folder")
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise _cannot_be_written(path, error) from error


def write_json(path: Path, document: Any) -> None:
    """Writes `document` as `write_file` does."""
    write_file(path, (json.dumps(document, indent=1) + "\n").encode())


def write_file(path: Path, content: bytes) -> None:
    """Writes `content`; a file is replaced at once or stays as it was.

    Raises:
        Unavailable: it cannot be written after all.
    """
    try:
        if path == STANDARD_OUTPUT:
            if sys.stdout is None:
                raise OSError(errno.EBADF, "it is closed")
            sys.stdout.flush()
            sys.stdout.buffer.write(content)
            sys.stdout.buffer.flush()
        elif _is_special(path):
            path.write_bytes(content)
        else:
            draft = path.with_name(path.name + ".new")
            draft.write_bytes(content)
            draft.replace(path)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise Unavailable(f"{path} cannot be written: {error.strerror}.", "Make room, and start it again.") from error


def _is_special(path: Path) -> bool:
    """Whether it is there, but no regular file: a device, say, which must not be replaced."""
    return path.exists() and not path.is_file()


def _cannot_be_written(path: Path, error: OSError) -> InvalidInput:
    return InvalidInput(f"{path} cannot be written: {error.strerror}.", "Name a place that can be written.")
