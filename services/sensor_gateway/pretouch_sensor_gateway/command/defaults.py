"""Defaults that the commands share."""

DEFAULT_GATEWAY = "127.0.0.1:50053"
