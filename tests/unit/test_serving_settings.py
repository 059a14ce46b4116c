"""Invalid settings and addresses are refused with a remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pretouch.channel import open_sync_channel
from pretouch.errors import InvalidInput
from pretouch.serving import Settings
from pretouch.serving.settings import is_loopback


@pytest.mark.parametrize(
    "settings",
    [
        {"port": -1},
        {"port": 65536},
        {"metrics_port": 70000},
        {"host": ""},
        {"token": ""},
        {"token": "  "},
        {"token": "two\nlines"},
        {"token": "tökén"},
        {"workers": 0},
        {"max_queue": -1},
        {"deadline": 0.0},
        {"deadline": float("nan")},
        {"grace": -1.0},
        {"log_level": "loud"},
        {"tls_cert": Path("cert.pem")},
        {"tls_key": Path("key.pem")},
        {"tls_client_ca": Path("ca.pem")},
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as caught:
        Settings(**settings)
    assert caught.value.detail
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("host", "loopback", "address"),
    [
        ("127.0.0.1", True, "127.0.0.1:1"),
        ("127.3.2.1", True, "127.3.2.1:1"),
        ("localhost", True, "localhost:1"),
        ("::1", True, "[::1]:1"),
        ("0.0.0.0", False, "0.0.0.0:1"),
        ("::", False, "[::]:1"),
        ("robot.example", False, "robot.example:1"),
    ],
)
def test_loopback_is_told_from_the_rest(host: str, loopback: bool, address: str) -> None:
    assert is_loopback(host) is loopback
    assert Settings(host=host).address(1) == address


def test_the_token_stays_out_of_the_settings_text() -> None:
    assert "s3cret" not in repr(Settings(token="s3cret"))


@pytest.mark.parametrize("address", ["", "host", "host:", "host:port", "host:0", "host:99999", "http://host:50050"])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InvalidInput, match="not a gRPC address"):
        open_sync_channel(address)


@pytest.mark.parametrize("address", ["127.0.0.1:50050", "[::1]:50050", "detector:50051", "dns:///detector:50051"])
def test_addresses_open_without_connecting(address: str) -> None:
    open_sync_channel(address).close()
