"""Files that users name are read within bounds; pipes, devices and folders are refused at once."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from pretouch_sensor_gateway.configuration import load_configuration
from pretouch_sensor_gateway.recording.validation import check_recording

from pretouch.client.images import load_depth, load_mask
from pretouch.errors import InvalidInput, NotFound, TooLarge
from pretouch.regular_file import read_regular_file
from pretouch.tls import channel_credentials, server_credentials

READERS: list[Callable[[Path], object]] = [
    load_depth,
    load_mask,
    lambda path: channel_credentials(path, None, None),
    lambda path: server_credentials(path, path, None),
    lambda path: load_configuration({"PRETOUCH_GATEWAY_DEVICES": str(path)}),
    check_recording,
]


@pytest.mark.parametrize("read", READERS)
@pytest.mark.timeout(60)
def test_a_pipe_is_not_waited_for_and_a_device_not_read(read: Callable[[Path], object], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "endless.toml").symlink_to("/dev/zero")
    for name in ("pipe.toml", "endless.toml"):
        with pytest.raises((NotFound, InvalidInput), match="not a regular file"):
            read(tmp_path / name)


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_regular_file(path, 5) == b"12345"
    with pytest.raises(TooLarge, match="more than 4 bytes"):
        read_regular_file(path, 4)
