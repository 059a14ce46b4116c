"""The tokens that a service knows: one, or a file of several that may change while it runs."""

from __future__ import annotations

import hmac
import os
import re
import secrets
import stat
import time
import tomllib
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import structlog

from pretouch.errors import InvalidInput, NotFound, PretouchError, TooLarge
from pretouch.regular_file import read_regular_file
from pretouch.serving.caller import Caller

ROLES = ("full", "read")
_LOOK_EVERY = 1.0  # s between looks at the file
_MAX_BYTES = 1024 * 1024
_OWNER = re.compile(r"[A-Za-z0-9._-]{1,64}")
_DIGEST = re.compile(r"[0-9a-f]{64}")
_REMEDY = (
    'Write entries as `pretouch token new OWNER` prints them: [[tokens]], owner = "..", role = "full", sha256 = ".."'
)

_log = structlog.get_logger("pretouch.tokens")


@dataclass(frozen=True)
class KnownToken:
    """A token that is accepted, by its SHA-256: who calls with it, and what they may do."""

    digest: bytes
    caller: Caller


def make_token(owner: str, role: str = "full") -> tuple[str, str]:
    """A new random token, and its entry for a file of tokens.

    Raises:
        InvalidInput: a name that cannot be an owner's, or no role.
    """
    token = secrets.token_urlsafe(32)
    entry = {"owner": owner, "role": role, "sha256": sha256(token.encode()).hexdigest()}
    _parse_entry(entry)
    return token, "[[tokens]]\n" + "".join(f'{name} = "{value}"\n' for name, value in entry.items())


def read_tokens(path: Path) -> tuple[KnownToken, ...]:
    """The tokens of a TOML file of `[[tokens]]`, each with `owner`, `sha256` and, if not "full", `role`.

    Raises:
        InvalidInput: the file cannot be read, holds no token, or an entry is wrong.
    """
    try:
        document = tomllib.loads(read_regular_file(path, _MAX_BYTES).decode())
    except (ValueError, NotFound, TooLarge) as error:
        raise InvalidInput(f"The file of tokens {path} cannot be read: {error}.", _REMEDY) from error
    entries = document.get("tokens")
    if document.keys() != {"tokens"} or not isinstance(entries, list) or not entries:
        raise InvalidInput(f"The file of tokens {path} holds no entries [[tokens]], or something else.", _REMEDY)
    known = tuple(_parse_entry(entry) for entry in entries)
    if len({token.digest for token in known}) < len(known):
        raise InvalidInput(f"The file of tokens {path} names the same token twice.", "Give each entry its own token.")
    return known


def _parse_entry(entry: Any) -> KnownToken:
    if not isinstance(entry, dict) or not {"owner", "sha256"} <= entry.keys() <= {"owner", "sha256", "role"}:
        raise InvalidInput("An entry of the file of tokens has other members than owner, role and sha256.", _REMEDY)
    owner, digest, role = entry["owner"], entry["sha256"], entry.get("role", "full")
    if not isinstance(owner, str) or _OWNER.fullmatch(owner) is None:
        raise InvalidInput(f"The owner {owner!r:.80} is no name.", "Use up to 64 of A-Z, a-z, 0-9, '.', '_' and '-'.")
    if role not in ROLES:
        raise InvalidInput(f"The role of {owner} is {role!r:.80}.", f"Give one of {', '.join(ROLES)}.")
    if not isinstance(digest, str) or _DIGEST.fullmatch(digest) is None:
        raise InvalidInput(f"The sha256 of {owner} is none.", "Give 64 hexadecimal digits, lower case.")
    return KnownToken(bytes.fromhex(digest), Caller(owner, read_only=role == "read"))


class Tokens:
    """The tokens of a service: `token`, whose owner is "", and those of `path`, read again when the file changes.

    Raises:
        InvalidInput: the file is wrong. Once the service runs, a wrong file is logged and the last good one kept.
    """

    def __init__(self, token: str | None, path: Path | None) -> None:
        self._single = () if token is None else (KnownToken(sha256(token.encode()).digest(), Caller()),)
        self._path = path
        self._several: tuple[KnownToken, ...] = ()
        self._seen = _describe(path)
        self._look_again = time.monotonic() + _LOOK_EVERY
        if path is not None:
            self._several = read_tokens(path)
            _warn_if_exposed(path)

    @property
    def required(self) -> bool:
        """Whether a call must carry one."""
        return bool(self._single) or self._path is not None

    def identify(self, authorization: bytes) -> Caller | None:
        """Who calls with this `authorization`, b"" for none; None if that is nobody who may.

        It takes as long for a wrong token as for a right one, whatever the right ones are.
        """
        if not self.required:
            return Caller()
        self._follow_file()
        scheme, _, token = authorization.partition(b" ")
        digest = sha256(token.strip()).digest()
        found = None
        for known in (*self._single, *self._several):
            if hmac.compare_digest(known.digest, digest):
                found = known.caller
        return found if scheme.lower() == b"bearer" else None

    def _follow_file(self) -> None:
        now = time.monotonic()
        if self._path is None or now < self._look_again:
            return
        self._look_again = now + _LOOK_EVERY
        seen = _describe(self._path)
        if seen == self._seen:
            return
        self._seen = seen
        try:
            self._several = read_tokens(self._path)
        except PretouchError as error:
            _log.error("the file of tokens is wrong; the last good one counts", reason=error.detail)
            return
        _warn_if_exposed(self._path)
        _log.info("the file of tokens was read again", tokens=len(self._several))


def _describe(path: Path | None) -> tuple[int, int, int] | None:
    """What changes when the file does; None where there is no file."""
    try:
        status = None if path is None else os.stat(path)
    except OSError:
        return None
    return None if status is None else (status.st_mtime_ns, status.st_size, status.st_ino)


def _warn_if_exposed(path: Path) -> None:
    if stat.S_IMODE(os.stat(path).st_mode) & (stat.S_IRWXG | stat.S_IRWXO):
        _log.warning("other users can read or change the file of tokens: chmod 600 it", path=str(path))
