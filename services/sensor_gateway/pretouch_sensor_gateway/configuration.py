"""Which devices the gateway serves, from its environment."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import serial

from pretouch.errors import InvalidInput

VARIABLE = "PRETOUCH_GATEWAY_DEVICES"
_REMEDY = (
    f"Set {VARIABLE} to name=port,name=port: a name is of letters, digits, '-', '_' and '.', "
    "a port is a path or a pyserial URL."
)


@dataclass(frozen=True)
class DeviceSetting:
    """One device: the name that requests use, and the path or pyserial URL of its port."""

    name: str
    port: str


def devices_from(environment: Mapping[str, str]) -> tuple[DeviceSetting, ...]:
    """The devices that `PRETOUCH_GATEWAY_DEVICES` lists, in its order; none if it is empty or not set.

    Raises:
        InvalidInput: an entry that is not name=port, a name given twice, a URL of an unknown kind.
    """
    settings: list[DeviceSetting] = []
    for entry in filter(None, map(str.strip, environment.get(VARIABLE, "").split(","))):
        name, _, port = map(str.strip, entry.partition("="))
        if not re.fullmatch(r"[\w.-]{1,64}", name) or not port:
            raise InvalidInput(f"{VARIABLE} holds {entry!r}, which is not name=port.", _REMEDY)
        if name in (other.name for other in settings):
            raise InvalidInput(f"{VARIABLE} names the device {name!r} twice.", "Give each device its own name.")
        try:
            serial.serial_for_url(port, do_not_open=True)
        except ValueError as error:
            raise InvalidInput(f"The port {port!r} of device {name!r} cannot be used: {error}.", _REMEDY) from error
        settings.append(DeviceSetting(name, port))
    return tuple(settings)
