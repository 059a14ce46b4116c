"""Good requests to start from: a small view of a box, made in code."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray
from pretouch_simulation.demo import request_for
from pretouch_simulation.fingers.ideal import ThinBeam
from pretouch_simulation.objects import MAKERS
from pretouch_simulation.protocol import TABLE, Case, generator, make_case
from pretouch_simulation.scanning import scan_along

from pretouch.camera import Camera, DepthImage
from pretouch.client import SyncClient
from pretouch.errors import NotFound
from pretouch.geometry import Pose
from pretouch.scan_prediction import Candidate
from pretouch.scene import Scene
from pretouch.session import SampleChunk, ScanPlan, Session, SessionRequest
from pretouch.tof import RangeSamples, Scan
from pretouch.v1 import calibrated_camera_pb2, common_pb2, detector_pb2, registrar_pb2, sensor_gateway_pb2
from pretouch.v1 import orchestrator_pb2 as pb
from pretouch.wire import common
from pretouch.wire.scan_prediction import candidate_to_proto
from pretouch.wire.session import request_to_proto, submission_to_proto, telling_to_proto

DEVICE, CAMERA = "finger", "head"
FINGER = ThinBeam()
_EVERY = 3
"""Pixels of the simulated image that one of the request's stands for."""
_USES = 40
"""Requests after which another session is opened."""


@cache
def case() -> Case:
    """The simulated view."""
    name = sorted(MAKERS)[0]
    return make_case(name, MAKERS[name](), 0)


def small_request() -> tuple[SessionRequest, NDArray[np.float32], NDArray[np.uint8]]:
    """What a robot asks for, its depth image (h, w) in metres and its mask, with a few thousand pixels."""
    full = request_for(case(), FINGER.sensor)
    asked = SessionRequest(_small_camera(), full.base_T_camera, depth_scale=1.0, sensor=full.sensor, camera_id=CAMERA)
    depth = np.ascontiguousarray(case().depth.metres[::_EVERY, ::_EVERY], dtype=np.float32)
    return asked, depth, np.where(case().mask[::_EVERY, ::_EVERY], np.uint8(255), np.uint8(0))


def _small_camera() -> Camera:
    camera = case().camera
    return Camera(camera.fx / _EVERY, camera.fy / _EVERY, camera.cx / _EVERY, camera.cy / _EVERY)


def measured(plan: ScanPlan) -> RangeSamples:
    """The finger's samples along a plan."""
    return scan_along(case().world, plan.path, FINGER.sensor, FINGER, generator("finger"))


class OpenSession:
    """A session that awaits a scan: another one once it has ended, is gone or was used for a while."""

    def __init__(self, client: SyncClient[Any, Any]) -> None:
        self._client = client
        self._uses = 0
        self._id = ""

    def get(self) -> tuple[Session, ScanPlan]:
        self._uses += 1
        session = find(self._client, self._id) if self._uses % _USES else None
        if session is None or session.next_scan is None:
            session = self._client.create_session(*small_request())
        self._id = session.id
        assert session.next_scan is not None
        return session, session.next_scan


def find(client: SyncClient[Any, Any], session_id: str) -> Session | None:
    """The session, unless another request has purged it."""
    try:
        return client.session(session_id)
    except NotFound:
        return None


@cache
def _scene() -> common_pb2.Scene:
    asked, depth, mask = small_request()
    return common.scene_to_proto(Scene(DepthImage(depth), asked.camera, asked.base_T_camera, mask > 0, TABLE))


@cache
def _settings() -> registrar_pb2.RegistrationSettings:
    return registrar_pb2.RegistrationSettings(sensor=common.sensor_to_proto(FINGER.sensor))


def good_requests(sessions: OpenSession) -> dict[str, Callable[[], list[Message]]]:
    """By the method's full name, what makes the messages of a good call."""
    scans: list[Scan] = []
    candidates: list[registrar_pb2.CandidatePath] = []

    def plan() -> tuple[Session, ScanPlan]:
        session, planned = sessions.get()
        if not scans:
            scans.append(measured(planned).beams(FINGER.sensor))
            candidates.append(candidate_to_proto(Candidate(planned.path)))
        return session, planned

    def create() -> pb.CreateSessionRequest:
        return request_to_proto(*small_request())

    def submit() -> pb.SubmitScanRequest:
        session, planned = plan()
        return submission_to_proto(session.id, planned.scan_id, measured(planned))

    def tell() -> pb.TellSamplesRequest:
        session, planned = plan()
        return telling_to_proto(session.id, planned.scan_id, SampleChunk(0, measured(planned)))

    def scan_messages() -> list[Any]:
        plan()
        return [common.scan_to_proto(scan) for scan in scans]

    def register_stream() -> list[Message]:
        data = _scene().SerializeToString()
        step = registrar_pb2.RegisterStreamRequest
        header = registrar_pb2.RegisterStreamHeader(settings=_settings(), scene_bytes=len(data))
        chunks = [step(scene_chunk=data[k : k + 2**20]) for k in range(0, len(data), 2**20)]
        return [step(header=header), *chunks, *(step(scan=scan) for scan in scan_messages())]

    def points() -> list[Message]:
        pose = common.pose_to_proto(Pose.identity())
        tips = [sensor_gateway_pb2.TipPose(t=float(k), base_t_tip=pose) for k in range(3)]
        first = sensor_gateway_pb2.StreamPointsRequest(device=DEVICE, tip_t_module=[pose])
        return [first, *(sensor_gateway_pb2.StreamPointsRequest(tip_poses=[tip]) for tip in tips)]

    prefix = "/pretouch.v1."
    orchestrator, gateway = prefix + "OrchestratorService/", prefix + "SensorGatewayService/"
    return {
        orchestrator + "CreateSession": lambda: [create()],
        orchestrator + "GetSession": lambda: [pb.GetSessionRequest(session_id=plan()[0].id)],
        orchestrator + "ListSessions": lambda: [pb.ListSessionsRequest(limit=2)],
        orchestrator + "ListCameras": lambda: [calibrated_camera_pb2.ListCamerasRequest()],
        orchestrator + "GetCamera": lambda: [calibrated_camera_pb2.GetCameraRequest(camera_id=CAMERA)],
        orchestrator + "ForgetCamera": lambda: [calibrated_camera_pb2.ForgetCameraRequest(camera_id=CAMERA)],
        orchestrator + "SubmitScan": lambda: [submit()],
        orchestrator + "TellSamples": lambda: [tell()],
        orchestrator + "CancelSession": lambda: [pb.CancelSessionRequest(session_id=plan()[0].id)],
        orchestrator + "StreamEvents": lambda: [pb.StreamEventsRequest(session_id=plan()[0].id)],
        orchestrator + "RunSession": lambda: [
            pb.RunSessionRequest(session_id=plan()[0].id),
            pb.RunSessionRequest(samples=tell()),
            pb.RunSessionRequest(scan=submit()),
        ],
        prefix + "DetectorService/Propose": lambda: [
            detector_pb2.ProposeRequest(scene=_scene(), count=5, sensor=common.sensor_to_proto(FINGER.sensor))
        ],
        prefix + "DetectorService/ListProposers": lambda: [detector_pb2.ListProposersRequest()],
        prefix + "RegistrarService/Register": lambda: [
            registrar_pb2.RegisterRequest(scene=_scene(), scans=scan_messages(), settings=_settings())
        ],
        prefix + "RegistrarService/PredictScans": lambda: [
            registrar_pb2.PredictScansRequest(
                scene=_scene(), scans=scan_messages(), settings=_settings(), candidates=candidates
            )
        ],
        prefix + "RegistrarService/RegisterStream": register_stream,
        gateway + "ListDevices": lambda: [sensor_gateway_pb2.ListDevicesRequest()],
        gateway + "GetStatus": lambda: [sensor_gateway_pb2.GetStatusRequest(device=DEVICE)],
        gateway + "Configure": lambda: [
            sensor_gateway_pb2.ConfigureRequest(device=DEVICE, tip_t_module=[common.pose_to_proto(Pose.identity())])
        ],
        gateway + "StreamRanges": lambda: [sensor_gateway_pb2.StreamRangesRequest(device=DEVICE)],
        gateway + "StreamPoints": points,
        gateway + "GetSamples": lambda: [
            sensor_gateway_pb2.GetSamplesRequest(device=DEVICE, **{"from": 0.0, "to": 1.0})
        ],
    }
