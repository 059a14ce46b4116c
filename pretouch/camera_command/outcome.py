"""`pretouch camera export` and `pretouch camera forget`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pretouch.camera_command.options import CameraId
from pretouch.camera_export import ExportFormat, export_camera
from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import RestClient
from pretouch.results import STANDARD_OUTPUT, check_file, write_file
from pretouch.session_command.options import DEFAULT_URL, Url, open_console
from pretouch.session_command.wording import clean


def export(
    camera_id: CameraId,
    format: Annotated[ExportFormat, typer.Option(help="How it is written.")] = ExportFormat.YAML,
    out: Annotated[Path, typer.Option(help="The file to write; - is standard output.")] = STANDARD_OUTPUT,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Write the camera's corrected pose in base, with its covariance, for the robot's own configuration."""
    check_file(out)
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        camera = client.camera(camera_id)
    write_file(out, export_camera(camera, format).encode())


def forget(
    camera_id: CameraId,
    url: Url = DEFAULT_URL,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Forget all that was learned of a camera; its sessions stay."""
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        client.forget_camera(camera_id)
    open_console().print(f"Camera {clean(camera_id)} is forgotten.", soft_wrap=True)
