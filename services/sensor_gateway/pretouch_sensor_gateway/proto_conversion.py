"""Fused samples and the status of devices as messages of sensor_gateway.proto."""

from __future__ import annotations

from pretouch.v1 import sensor_gateway_pb2 as pb
from pretouch.wire.common import array_to_proto, samples_to_proto
from pretouch_sensor_gateway.device import Device
from pretouch_sensor_gateway.point_stream import FusedBatch
from pretouch_sensor_gateway.recording.recorder import Recorder
from pretouch_sensor_gateway.source import DeviceState, SourceStatus

_STATES = {
    DeviceState.CONNECTING: pb.DEVICE_STATE_CONNECTING,
    DeviceState.STREAMING: pb.DEVICE_STATE_STREAMING,
    DeviceState.SILENT: pb.DEVICE_STATE_SILENT,
    DeviceState.ENDED: pb.DEVICE_STATE_ENDED,
}


def points_to_proto(batch: FusedBatch) -> pb.StreamPointsResponse:
    fused = batch.fused
    return pb.StreamPointsResponse(
        samples=samples_to_proto(fused.samples),
        points=array_to_proto(fused.points, "f8"),
        lost=batch.lost,
        unposed=fused.unposed,
        origins=array_to_proto(fused.origins, "f8"),
        directions=array_to_proto(fused.directions, "f8"),
        std=array_to_proto(fused.std, "f8"),
        flags=array_to_proto(fused.flags, "u1"),
        overrun=batch.overrun,
        now=batch.now,
        out_of_order=batch.out_of_order,
        clock_offset=batch.clock_offset,
        clock_offset_std=batch.clock_offset_std,
    )


def device_to_proto(device: Device) -> pb.Device:
    """A device as ListDevices reports it."""
    source = device.source.status()
    return pb.Device(
        name=device.name,
        port=device.address,
        state=_STATES[source.state],
        frames=source.measurements,
        bad_frames=source.refused.total(),
        lost_frames=source.lost,
        problem=source.problem,
    )


def status_to_proto(device: Device) -> pb.GetStatusResponse:
    """A device's status as GetStatus reports it."""
    status = device.status()
    source = status.source
    return pb.GetStatusResponse(
        device=device_to_proto(device),
        format=source.format,
        unit=source.unit,
        recent_lines=source.recent_lines,
        identity=_identity_to_proto(source),
        epoch=source.epoch,
        connections=source.connections,
        refused={reason.name.lower(): count for reason, count in source.refused.items()},
        untimed=source.untimed,
        rate=status.rate,
        clock=pb.ClockStatus(
            synchronised=source.clock.synchronised,
            drift=source.clock.drift,
            std=source.clock.std,
            round_trip=source.clock.round_trip,
            latency=source.clock.latency,
        ),
        modules=[
            pb.ModuleStatus(
                range=module.range,
                status=module.status,
                measurements=module.measurements,
                returns=module.returns,
                jumps=module.jumps,
                range_status=pb.RangeStatus.ValueType(module.range_status),
            )
            for module in status.modules
        ],
        recording=None if device.recorder is None else _recording_to_proto(device.recorder),
        subscribers=status.subscribers,
        overrun=status.overrun,
        host_clock_jumps=source.clock.host_jumps,
        configuration=device.configuration(),
        now=device.now(),
    )


def _identity_to_proto(source: SourceStatus) -> pb.Identity | None:
    identity = source.identity
    if identity is None:
        return None
    return pb.Identity(
        serial=identity.serial, firmware=identity.firmware, modules=identity.modules, period=identity.period
    )


def _recording_to_proto(recorder: Recorder) -> pb.RecordingStatus:
    status = recorder.status()
    return pb.RecordingStatus(
        on=status.on,
        path=status.path,
        bytes=status.bytes,
        frames=status.measurements,
        unrecorded=status.unrecorded,
        pending=status.pending,
        problem=status.problem,
    )
