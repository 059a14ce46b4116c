"""The folder of one device's recordings: `<root>/<device>/<device>-<number>-<UTC time>.mcap`.

The numbers increase, so that the order of the files does not depend on the host's clock. Files with other names belong
to the user and are left alone.
"""

from __future__ import annotations

import re
import time
from pathlib import Path

from pretouch.errors import InvalidInput


class Folder:
    """Names, counts and deletes a device's recordings.

    Attributes:
        path: where they are; it need not exist.

    Raises:
        InvalidInput: the device's name cannot be the name of a folder.
    """

    def __init__(self, root: Path, device: str) -> None:
        if device in {"", ".", ".."} or "/" in device or "\0" in device:
            raise InvalidInput(f"A device named {device!r} cannot be recorded.", "Give it the name of a folder.")
        self.path = root / device
        self._device = device
        self._own = re.compile(re.escape(device) + r"-(\d{6,})-\d{8}T\d{6}Z\.mcap")
        self._last = 0

    def list_recordings(self) -> list[Path]:
        """The device's recordings, the oldest first.

        Raises:
            OSError: the folder cannot be read; one that does not exist holds none.
        """
        if not self.path.exists():
            return []
        return sorted((path for path in self.path.iterdir() if self._own.fullmatch(path.name)), key=self._number)

    def bytes(self) -> int:
        """The size of all recordings.

        Raises:
            OSError: the folder cannot be read.
        """
        return sum(path.stat().st_size for path in self.list_recordings())

    def new_path(self, at: int) -> Path:
        """The path for a recording that starts at Unix time `at`, ns.

        Creates the folder, but not its root, which may be a disk that is not mounted.

        Raises:
            OSError: the folder cannot be created or read.
        """
        self.path.mkdir(exist_ok=True)
        self._last = max([self._last, *map(self._number, self.list_recordings())]) + 1
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(at // 10**9))
        return self.path / f"{self._device}-{self._last:06d}-{stamp}.mcap"

    def prune(self, total: int) -> None:
        """Deletes the oldest recordings until the rest has `total` bytes at most.

        Raises:
            OSError: one cannot be deleted.
        """
        sizes = [(path, path.stat().st_size) for path in self.list_recordings()]
        excess = sum(size for _, size in sizes) - total
        for path, size in sizes:
            if excess <= 0:
                break
            path.unlink()
            excess -= size

    def _number(self, path: Path) -> int:
        match = self._own.fullmatch(path.name)
        assert match is not None
        return int(match[1])
