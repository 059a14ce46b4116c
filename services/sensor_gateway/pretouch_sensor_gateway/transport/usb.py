"""Finds the serial port of a USB device among those that are plugged in."""

from __future__ import annotations

from collections.abc import Sequence

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from pretouch_sensor_gateway.transport.address import UsbAddress
from pretouch_sensor_gateway.transport.problem import PortProblem


def find_usb_port(address: UsbAddress) -> str:
    """The path of the one port that matches. Blocks.

    Raises:
        PortProblem: none matches, or more than one does; the text lists what is plugged in.
    """
    try:
        ports = sorted(port for port in list_ports.comports() if port.vid is not None)
    except (TypeError, ValueError) as error:  # pyserial reads numbers from files of a device that has just gone
        raise PortProblem("A USB device was unplugged while the ports were being listed.") from error
    matching = [port for port in ports if _matches(port, address)]
    if len(matching) == 1:
        return str(matching[0].device)
    if matching:
        name = "path of the right one in /dev/serial/by-path" if address.serial else "serial number too"
        raise PortProblem(
            f"{len(matching)} serial ports are USB {address}: {_describe_ports(matching)}. Give the {name}."
        )
    raise PortProblem(
        f"No serial port is USB {address}. There {f'are: {_describe_ports(ports)}' if ports else 'is none'}."
    )


def _matches(port: ListPortInfo, address: UsbAddress) -> bool:
    same_kind = (port.vid, port.pid) == (address.vendor, address.product)
    return same_kind and address.serial in ("", port.serial_number)


def _describe_ports(ports: Sequence[ListPortInfo]) -> str:
    return ", ".join(f"{port.device} ({port.usb_info()}, {port.description})" for port in ports)
