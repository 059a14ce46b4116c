"""What the services make of their extensions, in a process that sees the extended packages; prints one JSON object."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable
from typing import Any, cast

from pretouch_detector.servicer import DetectorServicer
from pretouch_orchestrator.rest import models
from pretouch_sensor_gateway.wire_formats.auto_detection import AUTO
from pretouch_sensor_gateway.wire_formats.parser import Measurement
from pretouch_sensor_gateway.wire_formats.registry import FORMATS, create_parser

from helpers.scenes import Box, View, World
from pretouch.scene import Scene
from pretouch.v1 import detector_pb2
from pretouch.wire.common import scene_to_proto


class _Context:
    async def run_in_thread(self, call: Callable[..., Any], *arguments: Any, memory: int = 0) -> Any:
        return call(*arguments)


async def _proposals() -> dict[str, Any]:
    servicer = DetectorServicer(cast(Any, _Context()))
    world, view = World((Box.standing((0.09, 0.07, 0.05)),)), View()
    depth, mask = world.depth(view)
    scene = scene_to_proto(Scene(depth, view.camera, view.base_T_camera, mask, world.table))
    context = cast(Any, None)
    answer = await servicer.Propose(detector_pb2.ProposeRequest(scene=scene, proposer="middle"), context)
    listed = await servicer.ListProposers(detector_pb2.ListProposersRequest(), context)
    return {
        "proposer": answer.proposer,
        "regions": len(answer.regions),
        "listed": {info.name: info.ready for info in listed.proposers},
    }


def _parsed(name: str) -> dict[str, Any]:
    parser = create_parser(name)
    received = parser.feed(b"44 mm\r\nd=45 mm\r\nd=46 mm\r\n")
    return {
        "format": parser.name,
        "ranges": [message.ranges for message in received if isinstance(message, Measurement)],
    }


def main() -> None:
    told = {
        "detector": asyncio.run(_proposals()),
        "gateway": {name: _parsed(name) for name in (AUTO, "labelled")},
        "formats": FORMATS,
        "rest": json.dumps(models.SessionRequest.model_json_schema()),
    }
    json.dump(told, sys.stdout)


if __name__ == "__main__":
    main()
