"""Mutated inputs from a seed, for the test suite: what a noisy line does to a device's stream."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence


def mutate(inputs: Sequence[bytes], count: int, seed: int) -> Iterator[bytes]:
    """`count` inputs, each one of `inputs` with one to eight changes."""
    chance = random.Random(seed)
    for _ in range(count):
        data = bytearray(chance.choice(inputs))
        for _ in range(chance.randint(1, 8)):
            _change(data, chance, inputs)
        yield bytes(data)


def _change(data: bytearray, chance: random.Random, inputs: Sequence[bytes]) -> None:
    start = chance.randrange(len(data) + 1)
    end = min(len(data), start + int(chance.expovariate(0.2)))
    match chance.randrange(6):
        case 0 if start < len(data):
            data[start] ^= 1 << chance.randrange(8)
        case 1:
            del data[start:end]
        case 2:
            data[start:start] = chance.randbytes(end - start + 1)
        case 3:
            data[start:start] = data[start:end] * chance.randint(1, 20)
        case 4:
            data[start:end] = chance.choice(b"\0\r\n ,;:#[]()-.0").to_bytes(1, "little")
        case _:
            other = chance.choice(inputs)
            data[start:] = other[chance.randrange(len(other)) :]
