"""One trace from the robot's call to the registrar's kernel, through real services; and nothing without a collector."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.running_up import TIMEOUT, Up, eventually
from helpers.scenes import Box, View, World
from helpers.trace_collector import TraceCollector
from opentelemetry.sdk.trace import TracerProvider

from pretouch.client import GrpcClient, RestClient
from pretouch.session import SessionRequest
from pretouch.tof import Sensor

pytestmark = pytest.mark.timeout(600)
FREE = ("--rest-port", "0", "--grpc-port", "0", "--gateway-port", "0")


def test_a_robots_call_and_the_kernel_it_causes_are_one_trace(tmp_path: Path) -> None:
    robot = TracerProvider().get_tracer("robot")
    with TraceCollector() as collector:
        variables = {"OTEL_EXPORTER_OTLP_ENDPOINT": collector.endpoint, "OTEL_BSP_SCHEDULE_DELAY": "100"}
        options = ("--state", str(tmp_path / "state"), "--log-level", "info", *FREE)
        with Up.running(tmp_path, "-m", "pretouch", "up", *options, **variables) as up:
            rest, grpc = up.ready()
            view, world = View(), World((Box.standing((0.08, 0.06, 0.05)),))
            depth, mask = world.depth(view)
            request = SessionRequest(camera=view.camera, base_T_camera=view.base_T_camera, depth_scale=1.0)
            with robot.start_as_current_span("make") as made, RestClient(rest) as client:
                session = client.create_session(request, depth.metres, mask.astype(np.uint8))
            plan = session.next_scan
            assert plan is not None
            samples = world.scanned(plan.path, Sensor())
            with robot.start_as_current_span("scan") as scanned, GrpcClient(grpc) as client:
                client.submit(session.id, plan.scan_id, samples)

            make, scan = (format(each.get_span_context().trace_id, "032x") for each in (made, scanned))
            maker, scanner = (format(each.get_span_context().span_id, "016x") for each in (made, scanned))
            propose = "pretouch.v1.DetectorService/Propose"
            eventually(lambda: len(collector.path_to(propose, make)) == 4)
            assert collector.path_to(propose, make) == [
                ("pretouch-detector", propose),
                ("pretouch-orchestrator", "detector Propose"),
                ("pretouch-orchestrator", "POST /v1/sessions"),
                ("", maker),
            ]
            eventually(lambda: len(collector.path_to("solve", scan)) == 6)
            path = collector.path_to("solve", scan)
            job = path.pop(1)
            assert job[1].startswith("job ")
            assert path == [
                ("pretouch-registrar", "solve"),
                ("pretouch-registrar", "pretouch.v1.RegistrarService/Register"),
                ("pretouch-orchestrator", "registrar Register"),
                ("pretouch-orchestrator", "pretouch.v1.OrchestratorService/SubmitScan"),
                ("", scanner),
            ]
            eventually(lambda: bool(collector.path_to("store write", scan)))
            log = [json.loads(line) for line in up.log.read_text().splitlines() if line.startswith("{")]
            assert {"detector", "registrar", "orchestrator"} <= {
                line["service"] for line in log if line.get("trace_id") in (make, scan)
            }


def test_without_a_collector_a_client_imports_nothing_of_opentelemetry() -> None:
    script = (
        "import sys; from pretouch.client import RestClient; from pretouch.tracing import propagated, span\n"
        "with span('x'): print(propagated(), [name for name in sys.modules if name.startswith('opentelemetry')])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=TIMEOUT, check=True)
    assert done.stdout == "{} []\n"
