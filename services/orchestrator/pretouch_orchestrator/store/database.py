"""What differs between databases: connections, transactions and errors. The statements are the same for all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Transaction(Protocol):
    """A transaction under way."""

    def execute(self, statement: str, values: Mapping[str, Any] = ..., /) -> list[dict[str, Any]]:
        """The rows, by column name, of a statement whose parameters are written `:name`.

        Statements may call `epoch()`: s since the Unix epoch by the database's clock.
        """
        ...

    def announce(self, topic: str) -> None:
        """Announces a change to all processes once the transaction is committed."""
        ...


class Database(Protocol):
    """A database that runs transactions in threads of its own."""

    async def read(self, work: Callable[[Transaction], T]) -> T:
        """What `work` returns; it sees one state of the database. Raises `Unavailable`."""
        ...

    async def write(self, work: Callable[[Transaction], T], *, patient: bool = True) -> T:
        """What `work` returns, after its transaction was committed. Raises `Unavailable`.

        Where a connection is lost `work` runs again, even if the lost transaction may have been committed; it is not
        repeated for long without `patient`.
        """
        ...

    def check_disk(self) -> None:
        """Raises `Unavailable` if the disk is almost full, where that can be seen from here."""
        ...

    async def shrink(self) -> None:
        """Gives some free space back to the file system, if the database does not do so by itself."""
        ...
