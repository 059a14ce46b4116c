"""TLS and mutual TLS between the channel and `pretouch.serving`, with certificates made here."""

from __future__ import annotations

import asyncio
import ssl
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import grpc
import httpx
import pytest
import trustme
from google.protobuf.wrappers_pb2 import StringValue
from helpers.serving_probe import Stub, running

from pretouch.channel import open_channel, open_sync_channel
from pretouch.errors import InvalidInput
from pretouch.serving import Settings, started

TIMEOUT = 20


@dataclass(frozen=True)
class Identity:
    """An authority's certificate and what it issued, as files."""

    ca: Path
    cert: Path
    key: Path


def issue(folder: Path, name: str) -> Identity:
    authority = trustme.CA()
    issued = authority.issue_cert("127.0.0.1")
    identity = Identity(*(folder / f"{name}.{part}.pem" for part in ("ca", "cert", "key")))
    authority.cert_pem.write_to_path(identity.ca)
    issued.cert_chain_pems[0].write_to_path(identity.cert)
    issued.private_key_pem.write_to_path(identity.key)
    return identity


@pytest.fixture
def server(tmp_path: Path) -> Identity:
    return issue(tmp_path, "server")


@pytest.fixture
def client(tmp_path: Path) -> Identity:
    return issue(tmp_path, "client")


async def ask(channel: grpc.aio.Channel) -> str:
    async with channel:
        return (await Stub(channel).unary(StringValue(value="hello"), timeout=TIMEOUT)).value


def ask_synchronously(channel: grpc.Channel) -> str:
    with channel:
        return Stub(channel).unary(StringValue(value="hello"), timeout=TIMEOUT).value


async def test_tls_serves_those_who_trust_its_authority_and_no_plaintext(server: Identity, client: Identity) -> None:
    settings = Settings(tls_cert=server.cert, tls_key=server.key, token="t")
    async with started("probe", running, settings) as service:
        address = f"127.0.0.1:{service.port}"
        assert await ask(open_channel(address, "t", server.ca)) == "hello"
        assert await asyncio.to_thread(ask_synchronously, open_sync_channel(address, "t", server.ca)) == "hello"
        for wrong in (open_channel(address, "t"), open_channel(address, "t", client.ca)):
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await ask(wrong)
            assert caught.value.code() is grpc.StatusCode.UNAVAILABLE
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await ask(open_channel(address, "wrong", server.ca))
        assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED


async def test_metrics_are_served_over_the_same_tls(server: Identity, client: Identity) -> None:
    settings = Settings(tls_cert=server.cert, tls_key=server.key, tls_client_ca=client.ca, metrics_port=0)
    async with started("probe", running, settings) as service:
        trusting = ssl.create_default_context(cafile=server.ca)
        url = f"https://127.0.0.1:{service.metrics_port}/metrics"
        silent = [await asyncio.open_connection("127.0.0.1", service.metrics_port) for _ in range(3)]
        async with httpx.AsyncClient(verify=trusting, trust_env=False) as stranger:
            with pytest.raises((httpx.TransportError, ssl.SSLError)):
                await stranger.get(url, timeout=TIMEOUT)
        trusting.load_cert_chain(client.cert, client.key)
        async with httpx.AsyncClient(verify=trusting, trust_env=False) as known:
            assert "pretouch_probe_calls" in (await known.get(url, timeout=TIMEOUT)).text
        for _, writer in silent:
            writer.close()
            with suppress(OSError):  # the server may have closed it first
                await writer.wait_closed()


async def test_mutual_tls_serves_only_clients_of_its_authority(server: Identity, client: Identity) -> None:
    settings = Settings(tls_cert=server.cert, tls_key=server.key, tls_client_ca=client.ca)
    async with started("probe", running, settings) as service:
        address = f"127.0.0.1:{service.port}"
        known = open_channel(address, None, server.ca, client.cert, client.key)
        assert await ask(known) == "hello"
        for stranger in (
            open_channel(address, None, server.ca),
            open_channel(address, None, server.ca, server.cert, server.key),
        ):
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await ask(stranger)
            assert caught.value.code() is grpc.StatusCode.UNAVAILABLE


async def test_unusable_tls_files_are_refused_by_name(server: Identity, client: Identity, tmp_path: Path) -> None:
    missing, nonsense = tmp_path / "missing.pem", tmp_path / "nonsense.pem"
    nonsense.write_text("no certificate")
    for settings, culprit in (
        (Settings(tls_cert=missing, tls_key=server.key), missing),
        (Settings(tls_cert=nonsense, tls_key=server.key), nonsense),
        (Settings(tls_cert=server.cert, tls_key=client.key), client.key),
        (Settings(tls_cert=server.cert, tls_key=server.key, tls_client_ca=nonsense), nonsense),
    ):
        with pytest.raises(InvalidInput, match=culprit.name):
            async with started("probe", running, settings):
                pass
    for ca, cert, key in (
        (missing, None, None),
        (nonsense, None, None),
        (server.ca, client.cert, None),
        (server.ca, client.cert, server.key),
        (None, client.cert, client.key),
    ):
        with pytest.raises(InvalidInput) as caught:
            open_sync_channel("127.0.0.1:1", None, ca, cert, key)
        assert caught.value.remedy
