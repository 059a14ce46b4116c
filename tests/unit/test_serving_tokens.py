"""The tokens of a service: what a file of them may say, how it is followed, and how often a wrong one is told so."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import structlog

from pretouch.errors import InvalidInput, TooManyTries, Unauthenticated
from pretouch.serving import tokens
from pretouch.serving.admission import TokenCheck
from pretouch.serving.caller import Caller
from pretouch.serving.tokens import Tokens, make_token, read_tokens
from pretouch.serving.tries import WrongTries


def write(path: Path, *entries: str) -> Path:
    path.write_text("\n".join(entries))
    path.chmod(0o600)
    return path


def bearer(token: str) -> bytes:
    return f"Bearer {token}".encode()


def test_each_token_has_its_owner_and_role_and_the_single_one_has_none(tmp_path: Path) -> None:
    (one, entry_1), (two, entry_2), (watcher, entry_3) = (
        make_token("line-1"),
        make_token("line-1"),
        make_token("w", "read"),
    )
    known = Tokens("single", write(tmp_path / "tokens.toml", entry_1, entry_2, entry_3))
    for token in (one, two):
        assert known.identify(bearer(token)) == Caller("line-1")
    assert known.identify(bearer(watcher)) == Caller("w", read_only=True)
    assert known.identify(bearer("single")) == Caller()
    for wrong in (
        b"",
        b"Bearer",
        b"Bearer ",
        bearer("other"),
        one.encode(),
        b"Basic " + one.encode(),
        bearer(one + "x"),
    ):
        assert known.identify(wrong) is None
    for scheme in (b"bearer ", b"BEARER  "):
        assert known.identify(scheme + one.encode()) == Caller("line-1")
    assert Tokens(None, None).identify(b"") == Caller()


def test_the_file_holds_no_token(tmp_path: Path) -> None:
    token, entry = make_token("line-1")
    assert token not in entry
    assert len(token) >= 40


@pytest.mark.parametrize(
    "text",
    [
        "",
        "tokens = []",
        "tokens = 3",
        "no toml",
        '[[tokens]]\nowner = "a"',
        '[[tokens]]\nowner = "a"\nsha256 = "xyz"',
        '[[tokens]]\nowner = "a/b"\nsha256 = "{digest}"',
        '[[tokens]]\nowner = ""\nsha256 = "{digest}"',
        '[[tokens]]\nowner = "a"\nsha256 = "{digest}"\nrole = "root"',
        '[[tokens]]\nowner = "a"\nsha256 = "{digest}"\ntoken = "t"',
        '[[tokens]]\nowner = "a"\nsha256 = "{digest}"\n[[tokens]]\nowner = "b"\nsha256 = "{digest}"',
        '[[tokens]]\nowner = "a"\nsha256 = "{digest}"\n[more]\n',
    ],
)
def test_a_wrong_file_is_refused_with_a_remedy(text: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput) as caught:
        Tokens(None, write(tmp_path / "tokens.toml", text.replace("{digest}", "0" * 64)))
    assert caught.value.remedy


@pytest.mark.parametrize("name", ["missing.toml", ""])
def test_a_file_that_is_none_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_tokens(tmp_path / name)


def test_tokens_are_exchanged_while_the_service_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tokens, "_LOOK_EVERY", 0.0)
    (old, old_entry), (new, new_entry) = make_token("line-1"), make_token("line-1")
    path = write(tmp_path / "tokens.toml", old_entry)
    known = Tokens(None, path)
    with structlog.testing.capture_logs() as lines:
        write(path, old_entry, new_entry)
        assert [known.identify(bearer(token)) for token in (old, new)] == [Caller("line-1")] * 2
        write(tmp_path / "next.toml", new_entry)
        os.replace(tmp_path / "next.toml", path)
        assert [known.identify(bearer(token)) for token in (old, new)] == [None, Caller("line-1")]
        for wrong in (lambda: write(path, "half of an entr"), path.unlink):
            wrong()
            assert known.identify(bearer(new)) == Caller("line-1")
        write(path, old_entry)
        assert [known.identify(bearer(token)) for token in (old, new)] == [Caller("line-1"), None]
    assert [line["log_level"] for line in lines] == ["info", "info", "error", "error", "info"]
    assert not any(token in repr(lines) for token in (old, new))


def test_a_file_that_others_can_read_is_warned_of(tmp_path: Path) -> None:
    path = write(tmp_path / "tokens.toml", make_token("line-1")[1])
    path.chmod(0o644)
    with structlog.testing.capture_logs() as lines:
        Tokens(None, path)
    assert [line["log_level"] for line in lines] == ["warning"]


def test_after_many_wrong_tokens_an_address_must_wait_but_a_right_one_never() -> None:
    check = TokenCheck(Tokens("right", None))
    kinds = [type(check.refuse(bearer("wrong"), "10.0.0.1")) for _ in range(25)]
    assert kinds == [Unauthenticated] * 20 + [TooManyTries] * 5
    told = check.refuse(bearer("wrong"), "10.0.0.1")
    assert told.retry_after is not None
    assert 0 < told.retry_after <= 3
    assert check.identify(bearer("right")) == Caller()
    for authorization, address in ((bearer("wrong"), "10.0.0.2"), (b"", "10.0.0.1")):
        assert type(check.refuse(authorization, address)) is Unauthenticated


def test_tries_come_back_and_what_is_kept_of_addresses_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now)
    tries = WrongTries()
    waits = [tries.spend(f"2001:db8::{k:x}") for k in range(21)]  # one network
    assert waits[:20] == [0.0] * 20
    assert waits[20] == pytest.approx(3.0)
    now += 3.01
    assert [tries.spend("2001:db8::1") > 0 for _ in range(2)] == [False, True]
    for k in range(30_000):
        tries.spend(str(k))
    assert len(tries._free_at) == 10_000
