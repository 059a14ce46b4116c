"""What the commands of cameras share."""

from __future__ import annotations

from typing import Annotated

import typer

CameraId = Annotated[str, typer.Argument(metavar="CAMERA", help="The camera's name: camera.id of its sessions.")]
