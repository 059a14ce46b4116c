"""Addresses: what can be opened, what never can, and how a USB device is found among those plugged in."""

from __future__ import annotations

import errno
import socket
import termios

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.transport.address import (
    Address,
    PathAddress,
    SocketAddress,
    UsbAddress,
    parse_address,
)
from pretouch_sensor_gateway.transport.problem import PortProblem, serial_problem, socket_problem
from pretouch_sensor_gateway.transport.usb import find_usb_port
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from pretouch.errors import InvalidInput


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("/dev/ttyACM0", PathAddress("/dev/ttyACM0")),
        (
            "/dev/serial/by-id/usb-Adafruit_QT_Py-if00",
            PathAddress("/dev/serial/by-id/usb-Adafruit_QT_Py-if00"),
        ),
        ("usb:2341:0043", UsbAddress(0x2341, 0x43, "")),
        ("usb:239a:80CB:DF609C80", UsbAddress(0x239A, 0x80CB, "DF609C80")),
        ("usb:303a:1001:24:0A:C4:00:01:02", UsbAddress(0x303A, 0x1001, "24:0A:C4:00:01:02")),
        ("socket://10.0.0.5:4000", SocketAddress("10.0.0.5", 4000)),
        ("socket://[fe80::1]:4000", SocketAddress("fe80::1", 4000)),
        ("socket://finger.lab:1", SocketAddress("finger.lab", 1)),
    ],
)
def test_an_address_is_a_path_a_usb_device_or_a_socket(text: str, address: Address) -> None:
    assert parse_address(text) == address


NEVER = (
    "| |ttyACM0|COM3|./port|/dev/serial/by-id/|/|/dev/tty\0|/dev/tty\n|"
    "usb:|usb:2341|usb:2341:|usb:2341:0043:|usb:12345:0043|usb:xyz:0043|usb://2341:0043|"
    "socket:|socket://|socket:///|socket://host|socket://:4000|socket://host:0|socket://host:65536|socket://host:x|"
    "socket://host:1/path|socket://host:1?logging=debug|socket://user@host:1|socket:host:1|socket://[fe80::1:1|"
    f"socket://host:1#|socket://{'x' * 64}:1|"
    "rfc2217://host:4000|loop://|hwgrep://finger|spy:///dev/ttyACM0|http://host:1"
)


@pytest.mark.parametrize("text", NEVER.split("|"))
def test_an_address_that_can_never_work_is_refused_with_what_to_do(text: str) -> None:
    with pytest.raises(InvalidInput) as refusal:
        parse_address(text)
    assert repr(text) in refusal.value.detail
    assert "socket://" in refusal.value.remedy or "usb:2341:0043" in refusal.value.remedy


@given(st.text() | st.builds("{}{}".format, st.sampled_from(["usb:", "socket://", "socket://h:", "/"]), st.text()))
def test_any_text_is_an_address_or_refused(text: str) -> None:
    try:
        address = parse_address(text)
    except InvalidInput:
        return
    assert isinstance(address, PathAddress | UsbAddress | SocketAddress)


def port(device: str, vid: int | None, pid: int | None, number: str | None = None) -> ListPortInfo:
    info = ListPortInfo(device, skip_link_detection=True)
    info.vid, info.pid, info.serial_number, info.description = vid, pid, number, "a board"
    return info


PLUGGED_IN = [
    port("/dev/ttyACM10", 0x2341, 0x0043, "A"),
    port("/dev/ttyACM2", 0x2341, 0x0043, "B"),
    port("/dev/ttyUSB0", 0x0403, 0x6001),
    port("/dev/ttyS0", None, None),
]


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> list[ListPortInfo]:
    ports = list(PLUGGED_IN)
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    return ports


@pytest.mark.usefixtures("plugged_in")
def test_a_usb_device_is_found_by_its_numbers() -> None:
    assert find_usb_port(UsbAddress(0x0403, 0x6001, "")) == "/dev/ttyUSB0"
    assert find_usb_port(UsbAddress(0x2341, 0x0043, "A")) == "/dev/ttyACM10"
    assert find_usb_port(UsbAddress(0x2341, 0x0043, "B")) == "/dev/ttyACM2"


def problem_of(address: UsbAddress) -> str:
    with pytest.raises(PortProblem) as problem:
        find_usb_port(address)
    return str(problem.value)


@pytest.mark.usefixtures("plugged_in")
def test_a_usb_device_that_is_not_there_is_a_problem_that_lists_those_that_are() -> None:
    assert problem_of(UsbAddress(0x2341, 0x0043, "C")) == (
        "No serial port is USB 2341:0043 with the serial number C. There are: "
        "/dev/ttyACM2 (USB VID:PID=2341:0043 SER=B, a board), "
        "/dev/ttyACM10 (USB VID:PID=2341:0043 SER=A, a board), "
        "/dev/ttyUSB0 (USB VID:PID=0403:6001, a board)."
    )


def test_no_usb_device_at_all_is_said_so(plugged_in: list[ListPortInfo]) -> None:
    del plugged_in[:3]
    assert problem_of(UsbAddress(0x2341, 0x0043, "")) == "No serial port is USB 2341:0043. There is none."


def test_two_usb_devices_that_fit_are_a_problem_that_says_how_to_choose(plugged_in: list[ListPortInfo]) -> None:
    text = problem_of(UsbAddress(0x2341, 0x0043, ""))
    assert text.startswith("2 serial ports are USB 2341:0043: /dev/ttyACM2 (")
    assert text.endswith("Give the serial number too.")
    plugged_in.append(port("/dev/ttyACM3", 0x2341, 0x0043, "A"))  # two ports of one device
    assert "/dev/serial/by-path" in problem_of(UsbAddress(0x2341, 0x0043, "A"))


def test_a_device_that_goes_while_it_is_looked_at_is_a_problem_only(monkeypatch: pytest.MonkeyPatch) -> None:
    def comports() -> list[ListPortInfo]:
        raise TypeError("int() can't convert non-string with explicit base")

    monkeypatch.setattr(list_ports, "comports", comports)
    assert "unplugged" in problem_of(UsbAddress(0x2341, 0x0043, ""))


def test_what_the_system_says_is_put_in_words() -> None:
    def words(error: Exception, path: str = "/dev/ttyACM0") -> str:
        return str(serial_problem(path, error))

    assert "not plugged in" in words(serial.SerialException(errno.ENOENT, "could not open port"))
    assert "group" in words(PermissionError(errno.EACCES, "Permission denied"), "/dev/null")
    assert "dialout" in words(PermissionError(errno.EACCES, "Permission denied"), "/dev/none")
    assert "Another program" in words(serial.SerialException(errno.EAGAIN, "Could not exclusively lock port"))
    assert "Another program" in words(OSError(errno.EBUSY, "Device or resource busy"))
    assert words(termios.error(errno.ENOTTY, "Inappropriate ioctl")) == "/dev/ttyACM0 is not a serial port."
    assert "Input/output error" in words(OSError(errno.EIO, "Input/output error"))


def test_why_a_connection_failed_is_put_in_words() -> None:
    def words(error: OSError) -> str:
        return str(socket_problem(SocketAddress("box", 4000), error))

    assert "cannot be resolved" in words(socket.gaierror(-2, "Name or service not known"))
    assert words(ConnectionRefusedError(errno.ECONNREFUSED, "")) == "Nothing listens at box, port 4000."
    assert words(TimeoutError("timed out")) == "There is no answer from box, port 4000."
    assert "No route to host" in words(OSError(errno.EHOSTUNREACH, "No route to host"))
