"""A file's bytes, and what they are when they are not what the file's name says."""

from __future__ import annotations

from pathlib import Path

from pretouch.errors import Malformed, NotFound, TooLarge
from pretouch.regular_file import check_regular_file

MAX_BYTES = 4 * 1024**3
_FOREIGN = {
    b"\x1f\x8b": ("is compressed with gzip", "Unpack it first: gunzip."),
    b"BZh": ("is compressed with bzip2", "Unpack it first: bunzip2."),
    b"\xfd7zXZ": ("is compressed with xz", "Unpack it first: unxz."),
    b"\x28\xb5\x2f\xfd": ("is compressed with zstd", "Unpack it first: unzstd."),
    b"\xff\xfe": ("is UTF-16 text", "Save it as ASCII or UTF-8."),
    b"\xfe\xff": ("is UTF-16 text", "Save it as ASCII or UTF-8."),
    b"version https://git-lfs": ("is a pointer of Git LFS, not the file itself", "Fetch it: git lfs pull."),
    b"<!DOCTYPE html": ("is a web page", "Download the file itself."),
    b"<html": ("is a web page", "Download the file itself."),
}
"""First bytes that no file of points or triangles begins with."""
_ZIP = b"PK\x03\x04"
_ZIPPED = (".npz", ".3mf")
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def read_bytes(path: Path) -> bytes:
    """The file's bytes, without UTF-8's byte order mark.

    Raises:
        NotFound: there is no such file, or it cannot be read.
        TooLarge: more than MAX_BYTES.
        Malformed: nothing is in it, or something that its suffix does not say, such as a compressed file.
    """
    check_regular_file(path)
    try:
        if (size := path.stat().st_size) > MAX_BYTES:
            raise TooLarge(f"{path.name} has {size} bytes; the limit is {MAX_BYTES}.", "Thin it out.")
        data = path.read_bytes()
    except OSError as error:
        raise NotFound(f"{path} cannot be read: {error.strerror}.", "Check the path.") from error
    if not data:
        raise Malformed(f"{path.name} is empty.", "Write the file again.")
    for first, (what, remedy) in _FOREIGN.items():
        if data.startswith(first):
            raise Malformed(f"{path.name} {what}.", remedy)
    if data.startswith(_ZIP) and path.suffix.lower() not in _ZIPPED:
        raise Malformed(f"{path.name} is a ZIP archive.", "Unpack it first.")
    return data.removeprefix(_BYTE_ORDER_MARK)
