"""Models of the JSON documents of devices, for OpenAPI, and how they are made of the gateway's answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, Field

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_from_proto
from pretouch_orchestrator.rest.derived_model import Pose, StrictModel
from pretouch_orchestrator.upstream.devices import PoseReport

_STATUS_PREFIX, _STATE_PREFIX = "RANGE_STATUS_", "DEVICE_STATE_"
_STATUS_NAMES = {number: name.removeprefix(_STATUS_PREFIX).lower() for name, number in pb.RangeStatus.items()}
RangeStatus = Literal["unspecified", "good", "no_target", "rejected", "failed", "no_answer"]


class Device(BaseModel):
    """A fingertip that the sensor gateway reads. Counts are since the gateway started."""

    name: str = Field(description="Name of the device.")
    port: str = Field(description="Path or URL of its port.")
    state: Literal["unspecified", "connecting", "streaming", "silent", "ended"] = Field(
        description="`streaming`: measurements arrive; `silent`: the port is open, but none do; `ended`: a recording "
        "was replayed to its end."
    )
    problem: str | None = Field(description="What is wrong with it, and what to do; null if nothing is.")
    measurements: int = Field(description="Number of valid measurements.")
    refused: int = Field(description="Number of frames or lines that were refused.")
    lost: int = Field(description="Number of measurements missing by sequence number.")


class DeviceList(BaseModel):
    """The devices."""

    devices: list[Device] = Field(description="The devices, in the order of the gateway's configuration.")


class DeviceClock(BaseModel):
    """How the device's clock is synchronised with that of the gateway's host."""

    synchronised: bool = Field(description="Whether it is; until then no measurement is passed on.")
    std: float | None = Field(description="Standard deviation of a measurement's time, in seconds; null: not known.")
    latency: float = Field(
        description="Time from a measurement to its line or frame that is subtracted, in seconds: as configured, or "
        "assumed."
    )


class DeviceModule(BaseModel):
    """One time-of-flight module: its last measurement."""

    range: float | None = Field(description="Range along the module's beam, in metres; null: none.")
    range_status: RangeStatus = Field(description="What became of the measurement, whatever the sensor.")
    status: int = Field(description="The sensor's own status code; 0 is good.")


class DeviceStatus(Device):
    """All that a robot needs to know of a device."""

    format: str | None = Field(description="Name of its wire format; null while that is not recognised.")
    rate: float = Field(description="Measurements per second over the last seconds, in hertz.")
    now: float = Field(
        description="The present by the clock of the gateway's host, in seconds since the Unix epoch: the clock of "
        "ranges, tip poses and spans."
    )
    clock: DeviceClock = Field(description="Synchronisation of the device's clock.")
    modules: list[DeviceModule] = Field(description="The modules, by their index.")


class TipPose(StrictModel):
    """A line of tip poses."""

    t: float = Field(
        description="Time in seconds since the Unix epoch on the clock of the gateway's host; with `clock_offset` on "
        "the robot's."
    )
    base_T_tip: Pose = Field(
        description="Pose of the tip in base at that time, translation in metres; the tip frame has z along the beam."
    )


class PosesReport(BaseModel):
    """What became of tip poses that were sent."""

    poses: int = Field(description="Number of tip poses that were sent.")
    out_of_order: int = Field(description="Number of those dropped because one of a later time had come before.")
    samples: int = Field(description="Number of ranges that were fused with them.")
    unposed: int = Field(
        description="Number of measurements dropped because no two tip poses close enough in time enclose them."
    )


def device_to_json(device: pb.Device) -> dict[str, Any]:
    return {
        "name": device.name,
        "port": device.port,
        "state": pb.DeviceState.Name(device.state).removeprefix(_STATE_PREFIX).lower(),
        "problem": device.problem or None,
        "measurements": device.frames,
        "refused": device.bad_frames,
        "lost": device.lost_frames,
    }


def status_to_json(status: pb.GetStatusResponse) -> dict[str, Any]:
    clock = status.clock
    return {
        **device_to_json(status.device),
        "format": status.format or None,
        "rate": status.rate,
        "now": status.now,
        "clock": {"synchronised": clock.synchronised, "std": _finite(clock.std), "latency": clock.latency},
        "modules": [
            {
                "range": _finite(module.range),
                "range_status": _STATUS_NAMES.get(module.range_status, "unspecified"),
                "status": module.status,
            }
            for module in status.modules
        ],
    }


def ranges_to_json(response: pb.StreamRangesResponse) -> dict[str, Any]:
    """The data of an event `ranges`: f measurements of k modules."""
    batch = response.batch
    names = [[_STATUS_NAMES.get(each, "unspecified") for each in row] for row in _rows(batch.range_status)]
    return {
        "t": _rows(batch.t),
        "time_std": _finite(batch.time_std),
        "epoch": batch.epoch,
        "sequence": _rows(batch.sequence),
        "range": [[_finite(each) for each in row] for row in _rows(batch.range)],
        "range_status": names,
        "status": _rows(batch.status),
        "flags": _rows(batch.flags),
        "lost": batch.lost,
        "overrun": response.overrun,
    }


def report_to_json(report: PoseReport) -> dict[str, Any]:
    return vars(report).copy()


def _rows(array: Any) -> list[Any]:
    rows: list[Any] = array_from_proto(array, "array").tolist()
    return rows


def _finite(number: float) -> float | None:
    return number if math.isfinite(number) else None


MODELS: Sequence[type[BaseModel]] = (Device, DeviceList, DeviceStatus, PosesReport)
"""Those of responses."""
