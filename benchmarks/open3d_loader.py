"""The one place that imports Open3D."""

from __future__ import annotations

import ctypes
import importlib
from functools import cache
from types import ModuleType

from pretouch.errors import Unavailable


@cache
def open3d() -> ModuleType:
    """Open3D, ready to use.

    It links against libusb-1.0.so.0, which a fresh Debian lacks; the package libusb-package carries it.

    Raises:
        Unavailable: it is not installed.
    """
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        module = importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise Unavailable(
            f"Open3D cannot be loaded: {error}.",
            "Install the benchmarks' peers, pip install 'pretouch[bench]', on x86-64 Linux with Python 3.11 or 3.12.",
        ) from error
    return module
