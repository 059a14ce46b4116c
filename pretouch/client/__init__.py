"""What a robot program imports: the orchestrator over REST and gRPC, synchronous and asynchronous.

    with RestClient("http://127.0.0.1:8080") as client:
        session = client.create_session(SessionRequest(camera, base_T_camera), depth)
        for session in drive(client, session, robot.scan):
            print(session.state, session.estimate.expected_error)
        base_T_correction = session.estimate.base_T_correction
        if session.reason is not None:
            print(session.reason["detail"], session.reason["remedy"])

All four clients have the same methods and raise the same errors, those of `pretouch.errors`.
"""

from pretouch.client.asynchronous import AsyncClient
from pretouch.client.calls import SessionPage
from pretouch.client.drive import drive, drive_async
from pretouch.client.events import Event
from pretouch.client.grpc import AsyncGrpcClient, GrpcClient
from pretouch.client.images import ImageLike
from pretouch.client.rest import AsyncRestClient, RestClient
from pretouch.client.synchronous import SyncClient

__all__ = [
    "AsyncClient",
    "AsyncGrpcClient",
    "AsyncRestClient",
    "Event",
    "GrpcClient",
    "ImageLike",
    "RestClient",
    "SessionPage",
    "SyncClient",
    "drive",
    "drive_async",
]
