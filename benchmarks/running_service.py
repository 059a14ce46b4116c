"""One service as a process of its own, and the processor seconds that it takes."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import psutil


@contextmanager
def service(name: str, **variables: str) -> Iterator[psutil.Process]:
    """`pretouch serve NAME` with these environment variables, once it is ready."""
    command = [sys.executable, "-m", "pretouch", "serve", name]
    process = subprocess.Popen(command, env=os.environ | variables, stderr=subprocess.PIPE)
    try:
        assert process.stderr is not None
        said = b""
        for said in process.stderr:
            if b'"ready"' in said:
                break
        else:
            raise RuntimeError(f"The {name} ended: {said.decode()}")
        threading.Thread(target=process.stderr.read, daemon=True).start()
        yield psutil.Process(process.pid)
    finally:
        process.terminate()
        process.wait(60)


def free_port() -> int:
    """A free port of 127.0.0.1, of those that the system gives nobody who does not ask for them."""
    while True:
        port = random.randrange(10_000, 32_000)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def processor_seconds(process: psutil.Process) -> float:
    """What the process and those that it started, as long as they live, have taken."""
    seconds = 0.0
    for each in (process, *process.children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            times = each.cpu_times()
            seconds += times.user + times.system
    return float(seconds)
