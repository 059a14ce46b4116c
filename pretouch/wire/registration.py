"""What a registration needs besides target and scans, as a message."""

from __future__ import annotations

from pretouch.geometry import Array
from pretouch.prior import AnyPrior
from pretouch.tof import Sensor
from pretouch.v1 import registrar_pb2
from pretouch.wire import common


def settings_to_proto(
    prior: AnyPrior, sensor: Sensor, at: Array | None = None, engine: str = ""
) -> registrar_pb2.RegistrationSettings:
    """The message.

    Args:
        at: (k, 3), m, in base, as the camera puts them: where errors count; None: at the object's visible points.
        engine: empty: the registrar's default.
    """
    return registrar_pb2.RegistrationSettings(
        engine=engine,
        sensor=common.sensor_to_proto(sensor),
        at=None if at is None else common.array_to_proto(at, "f8"),
        **common.prior_to_proto(prior),
    )
