"""Files that a user names: regular and of bounded size, since a pipe may wait forever and a device never ends."""

from __future__ import annotations

from pathlib import Path

from pretouch.errors import NotFound, TooLarge


def check_regular_file(path: Path) -> None:
    """
    Raises:
        NotFound: no such file, or a folder, a pipe or a device.
    """
    if path.is_dir():
        raise NotFound(f"{path} is a folder.", "Give a file.")
    if not path.exists():
        raise NotFound(f"There is no file {path}.", "Check the path.")
    if not path.is_file():
        raise NotFound(f"{path} is not a regular file.", "Write it to a file first.")


def read_regular_file(path: Path, limit: int) -> bytes:
    """The bytes of a file.

    Args:
        limit: the most bytes that are read.

    Raises:
        NotFound: no such file, a folder, a pipe, a device, or one that cannot be read.
        TooLarge: it has more than `limit` bytes.
    """
    check_regular_file(path)
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise NotFound(f"{path} cannot be read: {error.strerror}.", "Check its permissions.") from error
    if len(data) > limit:
        raise TooLarge(f"{path} has more than {limit} bytes.", "Check that it is the right file.")
    return data
