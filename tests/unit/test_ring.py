"""Which copy of a service is asked about what."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
from pretouch_orchestrator.upstream.ring import rank_copies

COPIES = st.sets(st.from_regex(r"10\.0\.0\.[0-9]{1,3}:50052", fullmatch=True), min_size=1, max_size=8)
KEYS = st.binary(min_size=32, max_size=32)


@given(COPIES, KEYS, st.randoms())
def test_the_order_depends_on_the_names_alone(copies: set[str], key: bytes, random: object) -> None:
    ranked = rank_copies(copies, key)
    assert sorted(ranked) == sorted(copies)
    assert rank_copies(sorted(copies), key) == ranked == rank_copies(reversed(sorted(copies)), key)


@given(COPIES, KEYS)
def test_without_a_copy_the_others_keep_their_order_so_that_only_its_keys_move(copies: set[str], key: bytes) -> None:
    ranked = rank_copies(copies, key)
    for gone in copies:
        assert rank_copies(copies - {gone}, key) == [copy for copy in ranked if copy != gone]


def test_keys_spread_evenly_and_a_new_copy_takes_its_share() -> None:
    keys = [number.to_bytes(32, "big") for number in range(3000)]
    three = [f"registrar-{k}:50052" for k in range(3)]
    homes = Counter(rank_copies(three, key)[0] for key in keys)
    assert all(900 < count < 1100 for count in homes.values())
    moved = [key for key in keys if rank_copies([*three, "registrar-3:50052"], key)[0] != rank_copies(three, key)[0]]
    assert 650 < len(moved) < 850
    assert all(rank_copies([*three, "registrar-3:50052"], key)[0] == "registrar-3:50052" for key in moved)
