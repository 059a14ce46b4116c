"""A fingertip behind a real pty, controlled by the test."""

from __future__ import annotations

import asyncio
import os
import time
import tty
from pathlib import Path

from pretouch_sensor_gateway.wire_formats.binary import FrameDecoder, encode
from pretouch_sensor_gateway.wire_formats.messages import Identify, Message, Ping
from pretouch_sensor_gateway.wire_formats.parser import Identity, Measurement, PingReply


class HandFinger:
    """A board that answers what it is asked by itself, and sends what it is told to.

    Args:
        link: the path of the port: a link to the pty.
    """

    def __init__(self, link: Path, *, boot: int = 1, serial: str = "00000000000000aa", modules: int = 1) -> None:
        self.boot = boot
        self._serial = serial
        self._modules = modules
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        self._decoder = FrameDecoder()
        asyncio.get_running_loop().add_reader(self._master, self._answer)

    def _answer(self) -> None:
        for message in self._decoder.feed(os.read(self._master, 4096)):
            if isinstance(message, Ping):
                self.send(PingReply(self.boot, message.sequence, self.micros()))
            elif isinstance(message, Identify):
                self.send(Identity(self.boot, self._serial, self._modules, 1 / 30, "hand 1.0"))

    @staticmethod
    def micros() -> int:
        return round(time.monotonic() * 1e6) % 2**32

    def send(self, message: Message) -> None:
        os.write(self._master, encode(message))

    def send_bytes(self, data: bytes) -> None:
        os.write(self._master, data)

    def frame(self, sequence: int, metres: float = 0.03) -> bytes:
        """The frame of a measurement taken now."""
        ranges, status = (metres,) * self._modules, (0,) * self._modules
        return encode(Measurement(self.boot, sequence, self.micros(), ranges, status))

    def measure(self, sequence: int, metres: float = 0.03) -> None:
        self.send_bytes(self.frame(sequence, metres))

    def unplug(self) -> None:
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
