"""The devices in the environment, or in the file that it names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pretouch_sensor_gateway.calibration.file import save
from pretouch_sensor_gateway.calibration.model import Calibration, ModuleCalibration
from pretouch_sensor_gateway.calibration.mounting import PARAMETERS, Mounting
from pretouch_sensor_gateway.configuration import VARIABLE, load_configuration

from pretouch.errors import InvalidInput
from pretouch.geometry import Pose


def test_devices_in_their_order() -> None:
    text = "left=/dev/serial/by-id/usb-x, right=socket://10.0.0.5:4000,third=usb:2341:0043,"
    setting = load_configuration({VARIABLE: text})
    assert [(device.name, device.address) for device in setting.devices] == [
        ("left", "/dev/serial/by-id/usb-x"),
        ("right", "socket://10.0.0.5:4000"),
        ("third", "usb:2341:0043"),
    ]
    assert setting.recordings is None


@pytest.mark.parametrize("environment", [{}, {VARIABLE: ""}, {VARIABLE: " , "}])
def test_no_devices_is_fine(environment: dict[str, str]) -> None:
    assert load_configuration(environment).devices == ()


def test_a_file_says_more(tmp_path: Path) -> None:
    modules = (ModuleCalibration(offset=0.002), ModuleCalibration())
    save(tmp_path / "finger.json", Calibration("00aa", 60.0, modules))
    (tmp_path / "gateway.toml").write_text(
        """
        recordings = "recordings"
        [devices.finger]
        address = "usb:2341:0043"
        format = "binary"
        baud = 230400
        latency = 0.022
        calibration = "finger.json"
        record = true
        modules = [
            { translation = [0, 0, 0], rotation = [0, 0, 0, 1] },
            { translation = [0.01, 0, 0], rotation = [0, 0.7071068, 0, 0.7071068] },
        ]
        [devices.plain]
        address = "/dev/ttyACM0"
        """
    )
    setting = load_configuration({VARIABLE: str(tmp_path / "gateway.toml")})
    assert setting.recordings == tmp_path / "recordings"
    finger, plain = setting.devices
    assert (finger.name, finger.wire_format, finger.baud, finger.record) == ("finger", "binary", 230_400, True)
    assert finger.latency == 0.022
    assert finger.calibration == Calibration("00aa", 60.0, modules)
    np.testing.assert_allclose(finger.tip_T_module[1].matrix[:3, 2], [1, 0, 0], atol=1e-6)
    assert (plain.name, plain.address, plain.wire_format, plain.calibration) == ("plain", "/dev/ttyACM0", "auto", None)
    np.testing.assert_array_equal(plain.tip_T_module[0].matrix, np.eye(4))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense = [", "cannot be read"),
        ("devices = 3", "not a table"),
        ("[devices.a]", "address"),
        ("[devices.a]\naddress = 3", "address"),
        ('[devices.a]\naddress = "/dev/x"\nspeed = 3', "speed"),
        ('[devices.a]\naddress = "/dev/x"\nformat = "morse"', "morse"),
        ('[devices.a]\naddress = "/dev/x"\nbaud = 0', "baud"),
        ('[devices.a]\naddress = "/dev/x"\nlatency = 22', "latency of 22 s"),
        ('[devices.a]\naddress = "/dev/x"\nlatency = "22 ms"', "latency"),
        ('[devices.a]\naddress = "/dev/x"\nrecord = 1', "record"),
        ('[devices.a]\naddress = "/dev/x"\nrecord = true', "no folder"),
        ('[devices.a]\naddress = "/dev/x"\ncalibration = "none.json"', "none.json"),
        ('[devices.a]\naddress = "/dev/x"\nmodules = [1]', "modules"),
        ('[devices."a b"]\naddress = "/dev/x"', "a b"),
        ('[devices.a]\naddress = "replay:none.mcap"', "none.mcap"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused_with_its_name(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=said) as caught:
        load_configuration({VARIABLE: str(path)})
    assert "gateway.toml" in caught.value.detail
    assert caught.value.remedy


def test_as_many_modules_must_be_calibrated_as_are_described(tmp_path: Path) -> None:
    save(tmp_path / "c.json", Calibration(modules=(ModuleCalibration(),) * 2))
    (tmp_path / "gateway.toml").write_text('[devices.a]\naddress = "/dev/x"\ncalibration = "c.json"')
    with pytest.raises(InvalidInput, match="2 modules are calibrated and 1 described"):
        load_configuration({VARIABLE: str(tmp_path / "gateway.toml")})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a=", "not name=port"),
        ("/dev/ttyUSB0", "not name=port"),
        ("=/dev/x", "not name=port"),
        ("a b=/dev/x", "no device name"),
        ("a=/dev/x,a=/dev/y", "twice"),
        ("a=nonsense://x", "another kind"),
        ("a=replay:/none.mcap", "none.mcap"),
        ("/none/gateway.toml", "cannot be read"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_remedy(text: str, said: str) -> None:
    with pytest.raises(InvalidInput, match=said) as caught:
        load_configuration({VARIABLE: text})
    assert caught.value.remedy


def test_modules_that_are_left_out_sit_where_the_calibrations_sweep_found_them(tmp_path: Path) -> None:
    placed = Pose.of(np.eye(3), [0.01, 0.0, 0.0])
    mounting = Mounting(placed, 0.0, 0.0, 0.2, 50.0, np.eye(len(PARAMETERS)), ())
    save(tmp_path / "c.json", Calibration(modules=(ModuleCalibration(mounting=mounting),)))
    line = "[devices.finger]\naddress = '/dev/ttyACM0'\ncalibration = 'c.json'\n"
    for written, x in ((line, 0.01), (line + "modules = [{translation=[0, 0, 0], rotation=[0, 0, 0, 1]}]", 0.0)):
        (tmp_path / "gateway.toml").write_text(written)
        (finger,) = load_configuration({VARIABLE: str(tmp_path / "gateway.toml")}).devices
        assert finger.tip_T_module[0].translation.tolist() == [x, 0.0, 0.0]
