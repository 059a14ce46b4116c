"""`pretouch session cancel` and `pretouch session purge`."""

from __future__ import annotations

from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import RestClient
from pretouch.session import Session, State
from pretouch.session_command.options import DEFAULT_URL, SessionId, Url, open_console
from pretouch.session_command.wording import clean, count_scans, describe_state


def cancel(
    session_id: SessionId,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Cancel a session at once, whatever step is under way; one that has ended stays as it is."""
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        before = client.session(session_id)
        client.cancel(session_id)
        after = client.session(session_id)
    open_console().print(describe_cancellation(before, after), soft_wrap=True)


def purge(
    session_id: SessionId,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Remove a session and all that is stored of it; one that is running is cancelled first."""
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        before = client.session(session_id)
        client.cancel(session_id, purge=True)
    open_console().print(describe_purge(before), soft_wrap=True)


def describe_cancellation(before: Session, after: Session) -> str:
    """What a cancellation did, in a sentence or two."""
    name = f"Session {clean(after.id)}"
    if before.state.ended:
        return f"{name} had ended already and stays as it is. It {describe_state(before)}."
    if after.state is not State.CANCELLED:
        return f"{name} ended by itself before it was cancelled. It {describe_state(after)}."
    return f"{name} is cancelled, after {count_scans(after)}."


def describe_purge(before: Session) -> str:
    """What a removal did, in a sentence or two."""
    was = describe_state(before) if before.state.ended else f"was running, after {count_scans(before)}"
    return f"Session {clean(before.id)} is removed, with all that was stored of it. It {was}."
