"""Which of several copies of a service is asked about what: rendezvous hashing.

Every copy gets a score for a key, and the one with the highest is the key's home. Without it the next one is; no other
key moves when a copy comes or goes (Thaler and Ravishankar, "Using name-based mappings to increase hit rates", 1998).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable


def rank_copies(copies: Iterable[str], key: bytes) -> list[str]:
    """The copies in the order in which they are asked about `key`; it depends on their names alone."""
    return sorted(copies, key=lambda copy: _score(copy, key), reverse=True)


def _score(copy: str, key: bytes) -> bytes:
    return hashlib.blake2b(key, digest_size=8, key=hashlib.blake2b(copy.encode()).digest()).digest()
