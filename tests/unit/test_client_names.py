"""The public names of `pretouch.client`, and the cost of importing it."""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.synchronous_client import SOURCES, generate, target

import pretouch.client
from pretouch.client import (
    AsyncClient,
    AsyncGatewayClient,
    AsyncGrpcClient,
    AsyncRestClient,
    GatewayClient,
    GrpcClient,
    RestClient,
    SyncClient,
)

METHODS = {
    *("create_session", "session", "sessions", "all_sessions", "next_scan"),
    *("submit", "tell", "cancel", "events", "close"),
    *("cameras", "camera", "forget_camera"),
}


def test_the_public_names_are_these() -> None:
    assert sorted(pretouch.client.__all__) == [
        *("AsyncClient", "AsyncGatewayClient", "AsyncGrpcClient", "AsyncRestClient", "Event", "GatewayClient"),
        *(
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
        ),
    ]
    assert all(hasattr(pretouch.client, name) for name in pretouch.client.__all__)


@pytest.mark.parametrize("kind", [RestClient, GrpcClient, AsyncRestClient, AsyncGrpcClient])
def test_every_client_has_the_same_methods_and_those_over_rest_the_downloads(kind: type) -> None:
    more = {"report", "recording"} if "Rest" in kind.__name__ else set()
    assert {name for name in dir(kind) if not name.startswith("_")} == METHODS | more


def test_synchronous_and_asynchronous_methods_take_the_same() -> None:
    for name in METHODS:
        sync, other = (inspect.signature(getattr(kind, name)).parameters for kind in (SyncClient, AsyncClient))
        assert sync == other, name


@pytest.mark.parametrize("kind", [GatewayClient, AsyncGatewayClient])
def test_the_gateways_clients_have_the_same_methods(kind: type) -> None:
    methods = {name for name in dir(kind) if not name.startswith("_")}
    assert methods == {"close", "configure", "devices", "points", "ranges", "samples", "status"}


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_the_synchronous_clients_are_generated_from_the_asynchronous_ones(source: Path) -> None:
    assert target(source).read_text() == generate(source), "Run `make client`."


def test_importing_the_client_is_light() -> None:
    script = "import sys; before = set(sys.modules); import pretouch.client; print(*(set(sys.modules) - before))"
    got = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    modules = got.stdout.split()
    heavy = {"torch", "trimesh", "fastapi", "starlette", "pydantic", "scipy", "numba", "matplotlib", "pandas"}
    assert not heavy & {name.partition(".")[0] for name in modules}
    assert not [name for name in modules if name.startswith(("pretouch_", "pretouch.serving"))]
    assert len(modules) < 600
