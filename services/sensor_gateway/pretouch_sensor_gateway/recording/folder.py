"""The folder of one device's recordings: `<root>/<device>/<device>-<number>-<UTC time>.mcap`.

The numbers grow, so that the order of the files does not hang on the host's clock. Files with other names are the
user's own and are left alone.
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
        InvalidInput: a device whose name is no name of a folder.
    """

    def __init__(self, root: Path, device: str) -> None:
        if device in {"", ".", ".."} or "/" in device or "\0" in device:
            raise InvalidInput(f"A device named {device!r} cannot be recorded.", "Give it the name of a folder.")
        self.path = root / device
        self._device = device
        self._own = re.compile(re.escape(device) + r"-(\d{6,})-\d{8}T\d{6}Z\.mcap")
        self._last = 0

    def recordings(self) -> list[Path]:
        """The oldest first.

        Raises:
            OSError: the folder cannot be read; one that does not exist holds none.
        """
        if not self.path.exists():
            return []
        return sorted((path for path in self.path.iterdir() if self._own.fullmatch(path.name)), key=self._number)

    def bytes(self) -> int:
        """Of all recordings.

        Raises:
            OSError: likewise.
        """
        return sum(path.stat().st_size for path in self.recordings())

    def new_path(self, at: int) -> Path:
        """Where a recording that begins `at`, ns since the Unix epoch, goes. Creates the folder, but not its root: that
        may be a disk which is not mounted.

        Raises:
            OSError: the folder cannot be created or read.
        """
        self.path.mkdir(exist_ok=True)
        self._last = max([self._last, *map(self._number, self.recordings())]) + 1
        stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(at // 10**9))
        return self.path / f"{self._device}-{self._last:06d}-{stamp}.mcap"

    def prune(self, total: int) -> None:
        """Deletes the oldest recordings until all have `total` bytes at most.

        Raises:
            OSError: one cannot be deleted.
        """
        sizes = [(path, path.stat().st_size) for path in self.recordings()]
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
