"""A signal that one part of a program waits for: in asyncio, and between threads."""

from asyncio import Event as AsyncSignal
from threading import Event as Signal

__all__ = ["AsyncSignal", "Signal"]
