"""A trace sums up all that was measured, in columns that stand still while time goes on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pretouch_sensor_gateway.watch.gauges import draw_bar, draw_sparkline
from pretouch_sensor_gateway.watch.trace import SPAN, SPANS, Summary, Trace

T0 = 1.7e9

steps = st.lists(st.floats(0.0, 2.0), min_size=1, max_size=60)


@given(steps=steps, misses=st.sets(st.integers(0, 59)), joined=st.integers(1, 8))
def test_every_measurement_of_the_columns_is_counted_once(steps: list[float], misses: set[int], joined: int) -> None:
    t = T0 + np.cumsum(steps)
    metres = np.linspace(0.02, 0.08, len(t))[:, None]
    metres[[k for k in misses if k < len(t)]] = np.nan
    trace = Trace(1)
    trace.add(t[: len(t) // 2], metres[: len(t) // 2])
    trace.add(t[len(t) // 2 :], metres[len(t) // 2 :])

    after = t[-1] + 8 * SPAN
    summary = trace.latest(after, 120 + 9, joined)

    begun = (math.floor(after / SPAN) // joined - 129) * joined * SPAN
    shown = t >= max(begun, (math.floor(t[-1] / SPAN) - SPANS + 1) * SPAN)
    over = t < math.floor(after / SPAN) // joined * joined * SPAN
    assert summary.measurements.sum() == (shown & over).sum()
    assert summary.returns.sum() == (shown & over & np.isfinite(metres[:, 0])).sum()
    assert np.nansum(summary.mean * summary.returns) == pytest.approx(np.nansum(metres[shown & over]))
    assert (np.isnan(summary.mean) == (summary.returns == 0)).all()


def test_columns_move_but_do_not_change_while_time_goes_on() -> None:
    trace = Trace(2)
    t = T0 + np.arange(300) / 30
    trace.add(t, np.stack([0.03 + 0.01 * np.sin(t), np.full(300, 0.05)], axis=1))
    for joined in (1, 3):
        now, later = trace.latest(T0 + 12, 20, joined), trace.latest(T0 + 12 + joined * SPAN, 20, joined)
        np.testing.assert_array_equal(now.mean[1:], later.mean[:-1])


def test_a_clock_that_is_set_back_begins_the_trace_anew_and_a_late_measurement_does_not() -> None:
    trace = Trace(1)
    trace.add(np.array([T0, T0 + 1]), np.array([[0.01], [0.02]]))
    trace.add(np.array([T0 + 0.5]), np.array([[0.03]]))
    assert trace.recent(T0 + 2, 5.0)[0] == 3
    trace.add(np.array([T0 - 3600]), np.array([[0.04]]))
    assert trace.recent(T0 + 2, 5.0)[0] == 0
    assert trace.recent(T0 - 3600 + 1, 5.0)[0] == 1


def test_what_is_kept_is_bounded() -> None:
    trace = Trace(1)
    for k in range(3):
        t = T0 + (k + np.arange(0, 1, 1 / SPANS)) * SPANS * SPAN
        trace.add(t, np.full((len(t), 1), 0.03))
    assert len(trace._spans) <= SPANS


def test_a_sparkline_tells_ranges_misses_and_gaps_apart() -> None:
    summary = Summary(
        measurements=np.array([7, 7, 0, 7, 7]),
        returns=np.array([[7], [7], [0], [0], [3]]),
        mean=np.array([[0.02], [0.06], [np.nan], [np.nan], [0.04]]),
    )
    text = draw_sparkline(summary, 0)
    assert text.plain == "▁▇ ·▄"
    assert [(span.start, span.end, span.style) for span in text.spans if span.style] == [
        (0, 2, "cyan"),
        (3, 5, "yellow"),
    ]


def test_noise_does_not_fill_a_sparkline() -> None:
    mean = np.array([[0.0300], [0.0304], [0.0301]])
    assert draw_sparkline(Summary(np.full(3, 7), np.full((3, 1), 7), mean), 0).plain == "▁▁▁"


@pytest.mark.parametrize(
    ("metres", "drawn"),
    [
        (0.0, "──────────"),
        (0.05, "━━━━━─────"),
        (0.0554, "━━━━━╸────"),
        (0.1, "━━━━━━━━━━"),
        (0.2, "━━━━━━━━━▶"),
        (math.nan, "──────────"),
    ],
)
def test_a_bar_is_as_long_as_its_range(metres: float, drawn: str) -> None:
    assert draw_bar(metres, 10, "green").plain == drawn
