"""Opens and closes ports. Both may block for long, so they belong into a thread. POSIX only, made for Linux."""

from __future__ import annotations

import fcntl
import os
import socket
import termios
from contextlib import suppress
from typing import Protocol

import serial

from pretouch_sensor_gateway.transport.address import Address, PathAddress, SocketAddress, UsbAddress
from pretouch_sensor_gateway.transport.problem import serial_problem, socket_problem
from pretouch_sensor_gateway.transport.usb import find_usb_port

_CONNECT_TIMEOUT = 5.0
_PEER_TIMEOUT = 10
"""Seconds after which a serial server that no longer responds counts as gone."""
_PTY_MAJORS = range(136, 144)
_PORT_ERRORS = (OSError, termios.error)
"""What a port that is unplugged, taken or missing raises: which of them depends on the driver and the moment."""


class Port(Protocol):
    """An open port, non-blocking in reading and writing."""

    def fileno(self) -> int: ...

    def close(self) -> None: ...


def open_port(address: Address, baud: int) -> Port:
    """Opens the port at `address` exclusively.

    Raises:
        PortProblem: it cannot be opened at present.
    """
    match address:
        case PathAddress(path):
            return _open_serial(path, baud)
        case UsbAddress():
            return _open_serial(find_usb_port(address), baud)
        case SocketAddress():
            return _connect(address)


def close_port(port: Port) -> None:
    """Closes the port without waiting for unsent bytes; also works for a port that is gone."""
    if isinstance(port, serial.Serial):
        with suppress(*_PORT_ERRORS):
            port.reset_output_buffer()
        with suppress(*_PORT_ERRORS):
            fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
    with suppress(*_PORT_ERRORS):
        port.close()


def _open_serial(path: str, baud: int) -> Port:
    try:
        # inter_byte_timeout=0 sets VMIN to 1: an empty queue is EAGAIN then, where with VMIN 0 it reads like a hang-up
        port: Port = serial.Serial(path, baud, timeout=0, write_timeout=0, inter_byte_timeout=0, exclusive=True)
        try:
            os.set_blocking(port.fileno(), False)
            _lock(port.fileno())
        except BaseException:
            port.close()
            raise
    except _PORT_ERRORS as error:
        raise serial_problem(path, error) from error
    return port


def _lock(fd: int) -> None:
    """Keeps other programs from reading the port: many ignore pyserial's lock, but the kernel enforces TIOCEXCL.

    Not for a pty, which would stay locked after this process was killed, for as long as its creator lives.
    """
    if os.major(os.fstat(fd).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def _connect(address: SocketAddress) -> Port:
    try:
        connection = socket.create_connection((address.host, address.port), _CONNECT_TIMEOUT)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # a server that loses power does not close: probe it, and give up data that it does not acknowledge
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _PEER_TIMEOUT // 2)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _PEER_TIMEOUT // 2)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _PEER_TIMEOUT * 1000)
        except BaseException:
            connection.close()
            raise
    except OSError as error:
        raise socket_problem(address, error) from error
    return connection
