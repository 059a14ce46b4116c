"""Where sessions are kept: one interface, `protocol.Store`, a file for each kind of store."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from enum import StrEnum
from importlib import import_module

from pretouch.errors import InvalidInput
from pretouch_orchestrator.store.protocol import Store


class StoreKind(StrEnum):
    """The kinds of store; each is the module of its name, with a function `open_store(place)`."""

    SQLITE = "sqlite"
    POSTGRESQL = "postgresql"


def open_store(address: str) -> AbstractAsyncContextManager[Store]:
    """Opens the store at `address`, which is KIND:PLACE: sqlite:FOLDER or postgresql://USER:PASSWORD@HOST/DATABASE.

    Raises:
        InvalidInput: there is no such kind.
        Unavailable: on entering, if the place is not usable.
    """
    kind, _, place = address.partition(":")
    if kind not in list(StoreKind):
        raise InvalidInput(
            f"There is no kind of store {kind!r:.80}.", f"Give KIND:PLACE, KIND one of {', '.join(StoreKind)}."
        )
    opened: AbstractAsyncContextManager[Store] = import_module(f"{__name__}.{kind}").open_store(place)
    return opened
