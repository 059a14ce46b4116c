"""Warns where other machines can reach a service that does not protect itself."""

from __future__ import annotations

from pretouch.serving.context import ServiceContext
from pretouch.serving.settings import is_loopback


def warn_if_exposed(context: ServiceContext, what: str, host: str) -> None:
    """Logs a warning for each protection that `what`, served at `host`, goes without although others can reach it."""
    settings = context.settings
    if is_loopback(host):
        return
    if not context.token_check.required:
        context.log.warning(
            "anyone on the network may call this service: set PRETOUCH_TOKEN or PRETOUCH_TOKENS_FILE",
            server=what,
            host=host,
        )
    if settings.tls_cert is None:
        context.log.warning(
            "calls cross the network unencrypted, tokens too: set PRETOUCH_TLS_CERT and PRETOUCH_TLS_KEY",
            server=what,
            host=host,
        )
