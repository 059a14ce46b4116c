"""All four clients use TLS, send a client certificate where it is required, and trust only the given authority."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import trustme
from helpers.box_session import DEPTH, MASK, request
from helpers.client_kinds import KINDS, opened
from helpers.fake_upstream import FakeUpstream
from helpers.processes import Orchestrator

from pretouch.errors import Unavailable
from pretouch.session import State


@dataclass(frozen=True)
class Sealed:
    """An orchestrator that serves TLS to those with a certificate, and the files that a client needs."""

    rest_url: str
    grpc_address: str
    ca: Path
    cert: Path
    key: Path
    other_ca: Path


@pytest.fixture(scope="module")
def sealed(fakes: FakeUpstream, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sealed]:
    folder = tmp_path_factory.mktemp("tls")
    files = {name: folder / f"{name}.pem" for name in ("ca", "cert", "key", "other_ca")}
    authority = trustme.CA()
    issued = authority.issue_cert("127.0.0.1")
    authority.cert_pem.write_to_path(files["ca"])
    issued.cert_chain_pems[0].write_to_path(files["cert"])
    issued.private_key_pem.write_to_path(files["key"])
    trustme.CA().cert_pem.write_to_path(files["other_ca"])
    variables = {
        "PRETOUCH_TLS_CERT": str(files["cert"]),
        "PRETOUCH_TLS_KEY": str(files["key"]),
        "PRETOUCH_TLS_CLIENT_CA": str(files["ca"]),
    }
    with Orchestrator(folder / "state", fakes.address, **variables) as service:
        yield Sealed(service.rest_url.replace("http:", "https:"), service.address, **files)


@pytest.mark.parametrize("kind", KINDS)
async def test_a_client_with_the_right_files_is_served(kind: str, sealed: Sealed) -> None:
    files = {"tls_ca": sealed.ca, "tls_cert": sealed.cert, "tls_key": str(sealed.key)}
    async with opened(kind, sealed.rest_url, sealed.grpc_address, **files) as client:
        session = await client.create_session(request(), DEPTH, MASK)
        await client.cancel(session.id)
        assert [event.type async for event in client.events(session.id)][-1] == "end"
        assert (await client.session(session.id)).state is State.CANCELLED


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("lack", ["the authority", "a certificate"])
async def test_a_client_without_them_is_not(kind: str, lack: str, sealed: Sealed) -> None:
    files = {"tls_ca": sealed.other_ca, "tls_cert": sealed.cert, "tls_key": sealed.key}
    if lack == "a certificate":
        files = {"tls_ca": sealed.ca}
    async with opened(kind, sealed.rest_url, sealed.grpc_address, timeout=2.0, **files) as client:
        with pytest.raises(Unavailable) as caught:
            await client.sessions()
    assert caught.value.remedy
