"""The devices in the environment."""

from __future__ import annotations

import pytest
from pretouch_sensor_gateway.configuration import VARIABLE, DeviceSetting, devices_from

from pretouch.errors import InvalidInput


def test_devices_in_their_order() -> None:
    text = "left=/dev/serial/by-id/usb-x, right=socket://10.0.0.5:4000?logging=debug,"
    assert devices_from({VARIABLE: text}) == (
        DeviceSetting("left", "/dev/serial/by-id/usb-x"),
        DeviceSetting("right", "socket://10.0.0.5:4000?logging=debug"),
    )


@pytest.mark.parametrize("environment", [{}, {VARIABLE: ""}, {VARIABLE: " , "}])
def test_no_devices_is_fine(environment: dict[str, str]) -> None:
    assert devices_from(environment) == ()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/dev/ttyUSB0", "not name=port"),
        ("a=", "not name=port"),
        ("=x", "not name=port"),
        ("a b=/dev/x", "not name=port"),
        ("a=/dev/x,a=/dev/y", "twice"),
        ("a=nonsense://x", "cannot be used"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_remedy(text: str, said: str) -> None:
    with pytest.raises(InvalidInput, match=said) as caught:
        devices_from({VARIABLE: text})
    assert caught.value.remedy
