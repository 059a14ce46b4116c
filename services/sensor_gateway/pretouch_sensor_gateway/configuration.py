"""Reads which devices the gateway serves, and their settings, from its environment.

`PRETOUCH_GATEWAY_DEVICES` is either `name=port,name=port`, or the path of a TOML file with all settings:

    recordings = "recordings"                # folder; left out: nothing can be recorded

    [devices.finger]
    address = "/dev/serial/by-id/usb-Pretouch_Finger_0042-if00"
    format = "binary"                        # default "auto": recognised; or a pattern: "{time:ms},{range:mm}"
    baud = 115200
    latency = 0.012                          # s; left out: not known
    calibration = "finger.json"              # what `pretouch gateway calibrate` wrote
    record = true
    no_target = [9999, "no object"]          # what else stands for no range in a text format
    modules = [                              # tip_T_module of each; default: one module at the tip
        { translation = [0, 0, 0], rotation = [0, 0, 0, 1] },
    ]
    zones = "vl53l5cx-8x8"                   # a multizone sensor: its zones are the modules, and modules its one pose

Paths are relative to the file's folder.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pretouch.errors import InvalidInput, NotFound, TooLarge
from pretouch.geometry import Pose
from pretouch.regular_file import read_regular_file
from pretouch.wire.reader import Members, prefix_errors, read_pose
from pretouch_sensor_gateway.calibration.file import load
from pretouch_sensor_gateway.calibration.model import Calibration
from pretouch_sensor_gateway.recording.validation import check_recording
from pretouch_sensor_gateway.transport.address import DEFAULT_BAUD, parse_address
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO
from pretouch_sensor_gateway.wire_formats.presets import PRESETS
from pretouch_sensor_gateway.wire_formats.registry import create_parser
from pretouch_sensor_gateway.wire_formats.text import Modules
from pretouch_sensor_gateway.zones import find_zones

VARIABLE = "PRETOUCH_GATEWAY_DEVICES"
_NAME = re.compile(r"[\w.-]{1,64}")
_REPLAY = "replay:"
_MAX_BYTES = 1_000_000
_KEYS = ("address", "format", "baud", "latency", "calibration", "modules", "zones", "no_target", "record")
MAX_LATENCY = 1.0
"""Seconds; no sensor measures for longer before its board sends."""
_REMEDY = (
    f"Set {VARIABLE} to name=port,name=port, or to the path of a .toml file: a name is of letters, digits, "
    "'-', '_' and '.'."
)


@dataclass(frozen=True)
class DeviceSetting:
    """The settings of one device.

    Attributes:
        name: as requests use it.
        address: as written; of a port, or of a recording to replay.
        wire_format: the name of its wire format, or a pattern of its lines.
        baud: bits a second of a real UART.
        latency: s from a measurement to the time in its frame, or to the begin of its line of text; None: not known.
        tip_T_module: pose of each module in the tip's coordinate frame.
        record: whether it is recorded from the start.
        modules: what is known of the modules beforehand.
        no_target: further numbers and words that stand for no range in a text format.
    """

    name: str
    address: str
    wire_format: str = AUTO
    baud: int = DEFAULT_BAUD
    latency: float | None = None
    calibration: Calibration | None = None
    tip_T_module: tuple[Pose, ...] = (Pose.identity(),)
    record: bool = False
    modules: Modules = field(default_factory=Modules)
    no_target: tuple[object, ...] = ()

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InvalidInput(f"{self.name!r} is no device name.", _REMEDY)
        create_parser(self.wire_format, self.modules, self.no_target)
        if self.recording is None:
            parse_address(self.address)
        else:
            check_recording(self.recording)
        if not 50 <= self.baud <= 12_000_000:
            raise InvalidInput(
                f"The baud rate {self.baud} is not possible.", "Give the bits a second of the UART, as 115200."
            )
        if self.latency is not None and not abs(self.latency) <= MAX_LATENCY:
            raise InvalidInput(
                f"A latency of {self.latency:g} s is not possible.",
                f"Give the seconds from a measurement to its line, at most {MAX_LATENCY:g}.",
            )
        if self.calibration is not None and len(self.calibration.modules) != len(self.tip_T_module):
            raise InvalidInput(
                f"{len(self.calibration.modules)} modules are calibrated and {len(self.tip_T_module)} described.",
                "Give the pose of each module, in the order of the calibration.",
            )

    @property
    def recording(self) -> Path | None:
        """The recording to replay, if the address names one."""
        return Path(self.address.removeprefix(_REPLAY)) if self.address.startswith(_REPLAY) else None


@dataclass(frozen=True)
class GatewaySetting:
    """The settings of all devices, and the folder for recordings; None: nothing can be recorded."""

    devices: tuple[DeviceSetting, ...] = ()
    recordings: Path | None = None


def load_configuration(environment: Mapping[str, str]) -> GatewaySetting:
    """Reads `PRETOUCH_GATEWAY_DEVICES`; no device if it is empty or not set.

    Raises:
        InvalidInput: an invalid entry or member, a name given twice, or a file that cannot be read.
    """
    value = environment.get(VARIABLE, "").strip()
    if value.endswith(".toml"):
        return _read_file(Path(value))
    devices: list[DeviceSetting] = []
    for entry in filter(None, map(str.strip, value.split(","))):
        name, _, address = map(str.strip, entry.partition("="))
        if not name or not address:
            raise InvalidInput(f"{VARIABLE} holds {entry!r}, which is not name=port.", _REMEDY)
        if name in (other.name for other in devices):
            raise InvalidInput(f"{VARIABLE} names the device {name!r} twice.", "Give each device its own name.")
        with prefix_errors(f"{VARIABLE}: {entry}"):
            devices.append(DeviceSetting(name, address))
    return GatewaySetting(tuple(devices))


def _read_file(path: Path) -> GatewaySetting:
    try:
        document = tomllib.loads(read_regular_file(path, _MAX_BYTES).decode())
    except (NotFound, TooLarge) as error:
        raise InvalidInput(f"The gateway's configuration cannot be read. {error.detail}", _REMEDY) from error
    except ValueError as error:  # TOML, or the encoding
        raise InvalidInput(
            f"The gateway's configuration {path} cannot be read: it is not TOML: {error}.", _REMEDY
        ) from error
    with prefix_errors(str(path)):
        members = Members(document, "", ("recordings", "devices"))
        recordings = path.parent / members.text("recordings") if "recordings" in members else None
        devices = members.get("devices", {})
        if type(devices) is not dict:
            raise InvalidInput("devices is not a table.", "Write each device as [devices.NAME].")
        settings = tuple(_read_device(name, value, path.parent) for name, value in devices.items())
        if recordings is None and any(setting.record for setting in settings):
            raise InvalidInput("A device is to be recorded, and there is no folder.", 'Set recordings = "FOLDER".')
    return GatewaySetting(settings, recordings)


def _read_device(name: str, value: object, folder: Path) -> DeviceSetting:
    with prefix_errors(f"devices.{name}"):
        members = Members(value, "", _KEYS)
        address = members.text("address")
        if address.startswith(_REPLAY):
            address = _REPLAY + str(folder / address.removeprefix(_REPLAY))
        record = members.get("record", False)
        if type(record) is not bool:
            raise InvalidInput("record is neither true nor false.", "Write record = true or leave it out.")
        calibration = load(folder / members.text("calibration"))[0] if "calibration" in members else None
        wire_format = members.text("format") if "format" in members else AUTO
        tip_T_module, modules = _read_modules(members, wire_format)
        return DeviceSetting(
            name,
            address,
            wire_format=wire_format,
            baud=members.integer("baud") if "baud" in members else DEFAULT_BAUD,
            latency=members.number("latency") if "latency" in members else None,
            calibration=calibration,
            tip_T_module=tip_T_module,
            record=record,
            modules=modules,
            no_target=_read_no_target(members.items("no_target")) if "no_target" in members else (),
        )


def _read_no_target(values: list[object]) -> tuple[object, ...]:
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float | str) or value == "":
            raise InvalidInput("no_target holds what no line can hold.", 'List numbers and words: [9999, "no object"].')
    return tuple(values)


def _read_modules(members: Members, wire_format: str) -> tuple[tuple[Pose, ...], Modules]:
    """The pose of each module in the tip's frame, and what is known of the modules."""
    stated = members.items("modules") if "modules" in members else None
    poses = tuple(read_pose(item, f"modules[{k}]") for k, item in enumerate(stated or ()))
    if "zones" not in members:
        return poses or (Pose.identity(),), Modules(len(poses) or None)
    if len(poses) > 1:
        raise InvalidInput("A sensor with zones has one pose.", "Give the sensor's pose alone in modules, or none.")
    preset = PRESETS.get(wire_format)
    zones, modules = find_zones(members.text("zones"), printed_mirrored=preset is not None and preset.mirrored)
    return tuple((poses or (Pose.identity(),))[0] @ zone for zone in zones), modules
