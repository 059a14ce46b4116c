"""How often an address may present a wrong token."""

from __future__ import annotations

import ipaddress
import time
from collections import OrderedDict

_BURST = 20  # wrong tokens at once
_REFILL = 60.0  # s until as many may follow
_MAX_ADDRESSES = 10_000


class WrongTries:
    """Counts the wrong tokens of each address; the networks /64 of IPv6 count as one each."""

    def __init__(self) -> None:
        self._free_at: OrderedDict[str, float] = OrderedDict()  # when all of an address's tries are free again

    def spend(self, address: str) -> float:
        """Counts a try; 0 if the address had one left, else the seconds until it has."""
        key, now, step = _network(address), time.monotonic(), _REFILL / _BURST
        free_at = max(now, self._free_at.pop(key, now))
        wait = free_at + step - now - _REFILL
        self._free_at[key] = free_at if wait > 0 else free_at + step
        if len(self._free_at) > _MAX_ADDRESSES:
            self._free_at.popitem(last=False)
        return max(0.0, wait)


def _network(address: str) -> str:
    try:
        ip = ipaddress.ip_address(address)
    except ValueError:
        return address
    return str(ipaddress.ip_network((ip, 64), strict=False)) if ip.version == 6 else address
