"""`pretouch camera list` and `pretouch camera show`."""

from __future__ import annotations

from pretouch.camera_command.options import CameraId
from pretouch.camera_command.views import describe, draw_history, tabulate_cameras, tabulate_left_out
from pretouch.cli import TlsCa, TlsCert, TlsKey, Token
from pretouch.client import RestClient
from pretouch.results import STANDARD_OUTPUT, check_file, write_json
from pretouch.session_command.options import DEFAULT_URL, Json, Url, open_console, print_paragraphs
from pretouch.wire.json import camera_list_to_json, camera_to_json


def list_cameras(
    url: Url = DEFAULT_URL,
    json: Json = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """List the cameras that sessions have named, and whether each is where it was."""
    if json is not None:
        check_file(json)
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        cameras = client.cameras()
    if json is not None:
        write_json(json, camera_list_to_json(cameras))
    if json == STANDARD_OUTPUT:
        return
    console = open_console()
    if cameras:
        console.print(tabulate_cameras(cameras))
    else:
        console.print("No session has named a camera yet: give it camera.id.")


def show(
    camera_id: CameraId,
    url: Url = DEFAULT_URL,
    json: Json = None,
    token: Token = None,
    tls_ca: TlsCa = None,
    tls_cert: TlsCert = None,
    tls_key: TlsKey = None,
) -> None:
    """Say what is known of a camera, then draw its error over time, and list the sessions that do not count."""
    if json is not None:
        check_file(json)
    with RestClient(url, token=token, tls_ca=tls_ca, tls_cert=tls_cert, tls_key=tls_key) as client:
        camera = client.camera(camera_id)
    if json is not None:
        write_json(json, camera_to_json(camera))
    if json == STANDARD_OUTPUT:
        return
    console = open_console()
    print_paragraphs(console, describe(camera))
    if camera.history:
        console.print(draw_history(camera, console.width))
    if camera.left_out:
        console.print(tabulate_left_out(camera))
