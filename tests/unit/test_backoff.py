"""The delays between tries."""

from hypothesis import given
from hypothesis import strategies as st

from pretouch.backoff import Backoff


def test_delays_double_up_to_the_limit_and_start_again_after_a_success() -> None:
    backoff = Backoff(0.5, 3.0)
    assert [backoff.next_delay() for _ in range(5)] == [0.5, 1.0, 2.0, 3.0, 3.0]
    backoff.reset()
    assert backoff.next_delay() == 0.5


@given(jitter=st.floats(0.0, 1.0), tries=st.integers(1, 8))
def test_jitter_only_shortens_a_delay(jitter: float, tries: int) -> None:
    exact, jittered = Backoff(0.1, 2.0), Backoff(0.1, 2.0, jitter)
    for _ in range(tries):
        most = exact.next_delay()
        assert (1.0 - jitter) * most - 1e-12 <= jittered.next_delay() <= most
