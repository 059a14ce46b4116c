"""What a registration needs besides target and scans, as a message."""

from __future__ import annotations

from pretouch.prior import AnyPrior
from pretouch.tof import Sensor
from pretouch.v1 import registrar_pb2
from pretouch.wire import common


def settings_to_proto(prior: AnyPrior, sensor: Sensor, engine: str = "") -> registrar_pb2.RegistrationSettings:
    """`engine` empty: the registrar's default."""
    return registrar_pb2.RegistrationSettings(
        engine=engine, sensor=common.sensor_to_proto(sensor), **common.prior_to_proto(prior)
    )
