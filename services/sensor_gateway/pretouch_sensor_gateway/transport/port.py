"""Opening and closing a port. Both may block for long, so they belong into a thread; POSIX only, Linux in mind."""

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
"""Seconds after which a serial server that was cut off without a word counts as gone."""
_PTY_MAJORS = range(136, 144)
_PORT_ERRORS = (OSError, termios.error)
"""What a port that is unplugged, taken or missing raises: which of them depends on the driver and the moment."""


class Port(Protocol):
    """An open port, set to neither block in reading nor in writing."""

    def fileno(self) -> int: ...

    def close(self) -> None: ...


def open_port(address: Address, baud: int) -> Port:
    """Opens the port at `address` for this process alone.

    Raises:
        PortProblem: it cannot be opened at present.
    """
    match address:
        case PathAddress(path):
            return _serial_port(path, baud)
        case UsbAddress():
            return _serial_port(find_usb_port(address), baud)
        case SocketAddress():
            return _connection(address)


def close_port(port: Port) -> None:
    """Closes the port without waiting for what it has not sent; a port that is gone is closed as well."""
    if isinstance(port, serial.Serial):
        with suppress(*_PORT_ERRORS):
            port.reset_output_buffer()
        with suppress(*_PORT_ERRORS):
            fcntl.ioctl(port.fileno(), termios.TIOCNXCL)
    with suppress(*_PORT_ERRORS):
        port.close()


def _serial_port(path: str, baud: int) -> Port:
    try:
        # inter_byte_timeout=0 sets VMIN to 1: an empty queue is EAGAIN then, where with VMIN 0 it reads like a hang-up
        port: Port = serial.Serial(path, baud, timeout=0, write_timeout=0, inter_byte_timeout=0, exclusive=True)
        try:
            os.set_blocking(port.fileno(), False)
            _keep_others_out(port.fileno())
        except BaseException:
            port.close()
            raise
    except _PORT_ERRORS as error:
        raise serial_problem(path, error) from error
    return port


def _keep_others_out(fd: int) -> None:
    """Lets no terminal program steal bytes: many ignore a lock such as pyserial's, but the kernel heeds TIOCEXCL.

    A pty would stay barred after this process was killed, for as long as its maker lives; it has only its lock.
    """
    if os.major(os.fstat(fd).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(fd, termios.TIOCEXCL)


def _connection(address: SocketAddress) -> Port:
    try:
        connection = socket.create_connection((address.host, address.port), _CONNECT_TIMEOUT)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # a server that loses its power says no goodbye: ask after it, and give up data that it does not confirm
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
