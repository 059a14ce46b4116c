"""Reads what a session's recording holds to register its scans again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from google.protobuf.message import DecodeError, Message

from pretouch.errors import InvalidInput, NotFound, TooLarge
from pretouch.recording.compatibility import find_unknown_fields
from pretouch.recording.reader import Recorded, RecordingReader
from pretouch.regular_file import check_regular_file
from pretouch.v1.session_recording_pb2 import RecordedScan, RecordedSession

MAX_FILE, MAX_UNPACKED = 128 * 2**20, 512 * 2**20
"""Bytes of the file and of what it holds: several times as many as the longest session that there can be."""
MAX_SCANS = 1000
_SESSION, _SCAN = RecordedSession.DESCRIPTOR.full_name, RecordedScan.DESCRIPTOR.full_name
_Kind = TypeVar("_Kind", bound=Message)


@dataclass(frozen=True)
class SessionRecording:
    """What is known of a recorded session; messages that nobody has validated yet.

    Attributes:
        scans: in their order.
        complete: whether the file was read to its end; a truncated one may lack scans.
    """

    session: RecordedSession
    scans: tuple[RecordedScan, ...]
    complete: bool


def read_session_recording(path: Path) -> SessionRecording:
    """The recording of a session at `path`; of a truncated file what is there.

    Raises:
        InvalidInput: it cannot be read, is no MCAP file or no recording of a session, or was written by a version that
            knows more than this one.
        TooLarge: it is larger than any recording of a session.
    """
    reader = RecordingReader(path, MAX_UNPACKED)
    session, scans = None, list[RecordedScan]()
    try:
        _check_file(path)
        for message in reader:
            if message.schema == _SESSION:
                session = _decode(message, RecordedSession, path)
            elif message.schema == _SCAN:
                scans.append(_decode(message, RecordedScan, path))
                _check_number(scans, path)
    except NotFound as error:
        raise InvalidInput(f"The recording cannot be read. {error.detail}", "Give the path of an MCAP file.") from error
    except OSError as error:
        raise InvalidInput(
            f"The recording {path} cannot be read: {error.strerror}.", "Give the path of an MCAP file."
        ) from error
    if session is None:
        cut = "" if reader.complete else " It is cut off or damaged."
        raise InvalidInput(
            f"{path} is no recording of a session: it holds no {_SESSION}.{cut}",
            "Give a file that `pretouch session recording` wrote.",
        )
    return SessionRecording(session, tuple(scans), reader.complete)


def _check_file(path: Path) -> None:
    check_regular_file(path)
    if (size := path.stat().st_size) > MAX_FILE:
        raise TooLarge(f"{path} has {size} bytes; the limit is {MAX_FILE}.", "Check that it is the right file.")


def _decode(message: Recorded, kind: type[_Kind], path: Path) -> _Kind:
    try:
        unknown = find_unknown_fields(message.described, kind)
        decoded = kind.FromString(message.data)
    except DecodeError as error:
        raise InvalidInput(f"The recording {path} is damaged.", "Give another recording.") from error
    if unknown:
        raise InvalidInput(
            f"{path} was recorded by another version of pretouch: this one does not know {', '.join(unknown)}.",
            "Update pretouch, or use the version that has recorded it.",
        )
    return decoded


def _check_number(scans: list[RecordedScan], path: Path) -> None:
    if len(scans) > MAX_SCANS:
        raise TooLarge(f"{path} holds more than {MAX_SCANS} scans.", "Check that it is the right file.")
    if scans[-1].number != len(scans):
        raise InvalidInput(
            f"The recording {path} is damaged: its scan number {len(scans)} is missing.", "Give another recording."
        )
