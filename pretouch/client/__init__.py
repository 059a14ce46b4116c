"""Clients of the orchestrator, and of the sensor gateway, for robot programs: synchronous and asynchronous.

    with RestClient("http://127.0.0.1:8080") as client:
        session = client.create_session(SessionRequest(camera, base_T_camera), depth)
        for session in drive(client, session, robot.scan):
            print(session.state, session.estimate.expected_error)
        base_T_correction = session.estimate.base_T_correction
        if session.reason is not None:
            print(session.reason["detail"], session.reason["remedy"])

All four clients of the orchestrator, over REST and gRPC, have the same methods, those over REST also `report` and
`recording`; `GatewayClient` and its asynchronous twin are of the sensor gateway. All raise the errors of
`pretouch.errors`. Metres, radians, seconds; `a_T_b` maps a point in b to a; the planned poses `base_T_tip` are those of
the fingertip sensor, z along the beam.
"""

from pretouch.client.api import SessionPage
from pretouch.client.asynchronous.client import AsyncClient
from pretouch.client.asynchronous.drive import drive_async
from pretouch.client.asynchronous.gateway import AsyncGatewayClient
from pretouch.client.asynchronous.grpc import AsyncGrpcClient
from pretouch.client.asynchronous.rest import AsyncRestClient
from pretouch.client.events import Event
from pretouch.client.gateway_api import Points, Ranges
from pretouch.client.guard import Guard
from pretouch.client.images import ImageLike
from pretouch.client.reflex import Reflex, add_descent
from pretouch.client.synchronous.client import SyncClient
from pretouch.client.synchronous.drive import drive
from pretouch.client.synchronous.gateway import GatewayClient
from pretouch.client.synchronous.grpc import GrpcClient
from pretouch.client.synchronous.rest import RestClient
from pretouch.client.untold import ScanPiece

__all__ = [
    "AsyncClient",
    "AsyncGatewayClient",
    "AsyncGrpcClient",
    "AsyncRestClient",
    "Event",
    "GatewayClient",
    "GrpcClient",
    "Guard",
    "ImageLike",
    "Points",
    "Ranges",
    "Reflex",
    "RestClient",
    "ScanPiece",
    "SessionPage",
    "SyncClient",
    "add_descent",
    "drive",
    "drive_async",
]
