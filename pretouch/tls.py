"""TLS material, read and checked before gRPC sees it, because gRPC's own message says only "failed to bind"."""

from __future__ import annotations

import ssl
from pathlib import Path

import grpc

from pretouch.errors import InvalidInput, NotFound
from pretouch.regular_file import check_regular_file


def server_credentials(cert: Path, key: Path, client_ca: Path | None) -> grpc.ServerCredentials:
    """A server's credentials; with `client_ca` every client must show a certificate that this authority signed.

    Raises:
        InvalidInput: a file cannot be used.
    """
    return grpc.ssl_server_credentials(
        [_pair(cert, key)],
        root_certificates=None if client_ca is None else _authority(client_ca),
        require_client_auth=client_ca is not None,
    )


def server_context(cert: Path, key: Path, client_ca: Path | None) -> ssl.SSLContext:
    """The same for a server of Python's own.

    Raises:
        InvalidInput: a file cannot be used.
    """
    _pair(cert, key)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(cert, key)
    if client_ca is not None:
        context.load_verify_locations(cadata=_authority(client_ca).decode())
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def channel_credentials(ca: Path, cert: Path | None, key: Path | None) -> grpc.ChannelCredentials:
    """A client's credentials: it trusts `ca` alone, and shows `cert` where the server asks for one.

    Raises:
        InvalidInput: a file cannot be used, or there is a certificate or a key but not both.
    """
    if cert is None and key is None:
        return grpc.ssl_channel_credentials(_authority(ca))
    if cert is None or key is None:
        raise InvalidInput("There is a client certificate or its key, but not both.", "Give both, or neither.")
    chain = _pair(cert, key)
    return grpc.ssl_channel_credentials(_authority(ca), *chain)


def client_context(ca: Path | None, cert: Path | None, key: Path | None) -> ssl.SSLContext:
    """As `channel_credentials`, for HTTP: without `ca` it trusts the system's authorities, and `cert` may hold the key.

    Raises:
        InvalidInput: a file cannot be used, or there is a key without a certificate.
    """
    if ca is not None:
        _authority(ca)
    context = ssl.create_default_context(cafile=ca)
    if cert is not None:
        _pair(cert, key or cert)
        context.load_cert_chain(cert, key)
    elif key is not None:
        raise InvalidInput("There is the key of a client certificate, but no certificate.", "Give both, or neither.")
    return context


def _pair(cert: Path, key: Path) -> tuple[bytes, bytes]:
    """The PEM bytes of a key and of its certificate chain, in gRPC's order."""
    try:
        check_regular_file(cert)
        check_regular_file(key)
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password=lambda: b"")
        return key.read_bytes(), cert.read_bytes()
    except (OSError, ValueError, NotFound) as error:
        raise InvalidInput(
            f"The certificate {cert} with the key {key} cannot be used: {error}.",
            "Give a PEM certificate and its own unencrypted PEM key, both readable for this user.",
        ) from error


def _authority(path: Path) -> bytes:
    """The PEM bytes of the authorities to trust."""
    try:
        check_regular_file(path)
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(path)
        return path.read_bytes()
    except (OSError, ValueError, NotFound) as error:
        raise InvalidInput(
            f"The certificate authority {path} cannot be used: {error}.", "Give a readable PEM file of certificates."
        ) from error
