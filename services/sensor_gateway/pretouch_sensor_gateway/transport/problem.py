"""Describes why a port is not open, for the person who has to fix it."""

from __future__ import annotations

import errno
import grp
import os
import socket

from pretouch_sensor_gateway.transport.address import Address, SocketAddress

_ABSENT = {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR}
_FORBIDDEN = {errno.EACCES, errno.EPERM}
_HELD = {errno.EBUSY, errno.EAGAIN}
_NO_TERMINAL = {errno.ENOTTY, errno.EISDIR, errno.EINVAL}


class PortProblem(Exception):
    """Why a port cannot be opened, in words for users."""


def serial_problem(path: str, error: Exception) -> PortProblem:
    """Why the serial port at `path` did not open."""
    number = _errno(error)
    if number in _ABSENT:
        return PortProblem(f"There is no device at {path}: it is not plugged in, or it has another name.")
    if number in _FORBIDDEN:
        return PortProblem(
            f"The gateway's user may not open {path}, which belongs to the group {_group(path)}: "
            "add the user to that group and log in anew."
        )
    if number in _HELD:
        return PortProblem(f"Another program or device entry holds {path}: `fuser -v {path}` names the program.")
    if number in _NO_TERMINAL:
        return PortProblem(f"{path} is not a serial port.")
    return PortProblem(f"{path} cannot be opened: {error}.")


def socket_problem(address: SocketAddress, error: OSError) -> PortProblem:
    """Why the connection to `address` failed."""
    place = f"{address.host}, port {address.port}"
    if isinstance(error, socket.gaierror):
        return PortProblem(f"The host name {address.host} cannot be resolved: {error.strerror}.")
    if isinstance(error, ConnectionRefusedError):
        return PortProblem(f"Nothing listens at {place}.")
    if isinstance(error, TimeoutError):
        return PortProblem(f"There is no answer from {place}.")
    return PortProblem(f"There is no way to {place}: {error.strerror or error}.")


def describe_loss(address: Address, error: OSError | None) -> str:
    """Why an open port was lost: `error` in reading it, or None for the end of the data."""
    end = (
        "The other end closed the connection"
        if isinstance(address, SocketAddress)
        else "The port hung up: the device was unplugged, or restarted"
    )
    return f"{end}." if error is None else f"{end} ({error.strerror or error})."


def _errno(error: BaseException) -> int | None:
    """The number behind what pyserial raises: its own, or that of the `termios.error` which it swallowed."""
    for one in (error, error.__context__):
        if one is not None and one.args and isinstance(one.args[0], int):
            return one.args[0]
    return None


def _group(path: str) -> str:
    try:
        return grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        return "dialout"
