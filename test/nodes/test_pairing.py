"""Samples out of messages: the same whatever the order of arrival."""

from __future__ import annotations

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from pam_antagonist.nodes.pairing import ANGLE, PRESSURE_1, PRESSURE_2, VOLTAGES, Sample, SamplePairing

MS = 1_000_000
TOPICS = (PRESSURE_1, PRESSURE_2, VOLTAGES)


class Clock:
    """Time that passes when told."""

    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        return self.now


def message(topic: int, k: int) -> tuple[int, int, tuple[float, ...]]:
    values = (1.0 * k, 2.0 * k) if topic == VOLTAGES else (10.0 * k + topic,)
    return topic, k * MS, values


def sample(k: int) -> Sample:
    return Sample(k * MS, 10.0 * k, 10.0 * k + 1.0, 1.0 * k, 2.0 * k)


def same(one: list[Sample], other: list[Sample]) -> bool:
    return len(one) == len(other) and all(
        all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in zip(x, y, strict=True))
        for x, y in zip(one, other, strict=True)
    )


def run(messages, clock: Clock, pairing: SamplePairing, step_ns: int = 0) -> list[Sample]:
    """Add messages; look for time-outs behind them, as a timer does."""
    out: list[Sample] = []
    for topic, stamp, values in messages:
        clock.now += step_ns
        out += pairing.add(topic, stamp, *values)
    return out + pairing.expire()


def fresh(timeout: float = 0.02) -> tuple[Clock, SamplePairing]:
    clock = Clock()
    return clock, SamplePairing(timeout, clock)


@st.composite
def interleavings(draw):
    """Three topics, each in its order, delivered in any order between them; some messages are never sent."""
    count = draw(st.integers(1, 60))
    one = st.tuples(st.sampled_from(TOPICS), st.integers(0, max(0, count - 2)))
    missing = draw(st.sets(one, max_size=10)) if count > 1 else set()
    queues = [[message(t, k) for k in range(count) if (t, k) not in missing] for t in TOPICS]
    order = []
    while any(queues):
        topic = draw(st.sampled_from([t for t in TOPICS if queues[t]]))
        burst = draw(st.integers(1, 30))
        order += queues[topic][:burst]
        del queues[topic][:burst]
    return count, missing, order


@settings(max_examples=100)
@given(interleavings(), st.sampled_from([0, MS // 100, 5 * MS]))
def test_any_interleaving_gives_the_same_samples(case, pace):
    """Also in bursts that are further apart than the time-out, in stamps and in time, as after a stall."""
    count, missing, order = case
    expected = []
    for k in range(count):
        values = [
            math.nan if (PRESSURE_1, k) in missing else 10.0 * k,
            math.nan if (PRESSURE_2, k) in missing else 10.0 * k + 1.0,
            *((math.nan, math.nan) if (VOLTAGES, k) in missing else (1.0 * k, 2.0 * k)),
        ]
        if not all(math.isnan(value) for value in values):
            expected.append(Sample(k * MS, *values))
    clock, pairing = fresh()
    out = run(order, clock, pairing, step_ns=pace)
    assert same(out, expected)
    assert pairing.counts.samples == len(expected)
    assert pairing.counts.incomplete == len({k for _, k in missing} & {s.stamp_ns // MS for s in expected})
    assert pairing.counts.late == pairing.counts.duplicates == pairing.counts.restarts == 0


def test_a_sample_comes_out_with_its_last_message_and_not_before():
    clock, pairing = fresh()
    assert pairing.add(PRESSURE_1, MS, 1.0) == []
    assert pairing.add(VOLTAGES, MS, 3.0, 4.0) == []
    assert pairing.add(PRESSURE_2, MS, 2.0) == [Sample(MS, 1.0, 2.0, 3.0, 4.0)]


def test_a_topic_that_stays_away_is_waited_for_and_then_missing():
    clock, pairing = fresh()
    out = []
    for k in range(100):
        clock.now = k * MS
        got = run([message(PRESSURE_1, k), message(VOLTAGES, k)], clock, pairing)
        out += [(clock.now - s.stamp_ns, s) for s in got]
    assert len(out) == 100 - 21  # the last ones still wait
    assert all(math.isnan(s.pressure_2) and s.pressure_1 == s.stamp_ns / MS * 10.0 for _, s in out)
    assert {delay for delay, _ in out} == {21 * MS}
    assert pairing.counts.incomplete == len(out)


def test_what_comes_after_its_sample_has_gone_is_dropped_and_counted():
    clock, pairing = fresh()
    for k in range(60):
        clock.now = k * MS
        run([message(PRESSURE_1, k), message(VOLTAGES, k)], clock, pairing)
    assert pairing.counts.samples == 39
    before = pairing.counts.samples
    assert run([message(PRESSURE_2, k) for k in range(30)], clock, pairing) == []
    assert pairing.counts.late == 30
    assert pairing.counts.samples == before


def test_the_first_of_two_messages_with_one_stamp_counts():
    clock, pairing = fresh()
    pairing.add(PRESSURE_1, MS, 1.0)
    pairing.add(PRESSURE_1, MS, 9.0)
    pairing.add(PRESSURE_2, MS, 2.0)
    assert pairing.add(VOLTAGES, MS, 3.0, 4.0) == [Sample(MS, 1.0, 2.0, 3.0, 4.0)]
    assert pairing.counts.duplicates == 1


def test_a_message_with_the_stamp_of_the_sample_that_has_just_gone_is_late():
    clock, pairing = fresh()
    assert run([message(t, 7) for t in TOPICS], clock, pairing) == [sample(7)]
    assert run([message(PRESSURE_1, 7)], clock, pairing) == []
    assert (pairing.counts.late, pairing.counts.duplicates) == (1, 0)


def test_a_jump_backwards_starts_anew():
    clock, pairing = fresh()
    run([message(t, k) for k in range(2000, 2010) for t in TOPICS], clock, pairing)
    out = run([message(t, k) for k in range(10) for t in TOPICS], clock, pairing)
    assert same(out, [sample(k) for k in range(10)])
    assert pairing.counts.restarts == 1


def test_a_small_step_back_is_no_restart():
    clock, pairing = fresh()
    run([message(t, k) for k in range(400, 410) for t in TOPICS], clock, pairing)
    assert run([message(t, 300) for t in TOPICS], clock, pairing) == []
    assert (pairing.counts.late, pairing.counts.restarts) == (3, 0)


def test_a_stray_stamp_from_the_future_does_not_stop_the_flow():
    clock, pairing = fresh()
    out = run([message(t, k) for k in range(5) for t in TOPICS], clock, pairing)
    out += run([(PRESSURE_1, 10**18, (1.0,))], clock, pairing)
    for k in range(5, 200):
        clock.now += MS
        out += run([message(t, k) for t in TOPICS], clock, pairing)
    assert [s.stamp_ns for s in out] == [k * MS for k in range(200)]
    assert all(s.pressure_2 == s.stamp_ns / MS * 10.0 + 1.0 for s in out)


def test_stamps_that_stand_still_do_not_fill_the_memory():
    clock, pairing = fresh()
    for k in range(7_000):
        pairing.add(PRESSURE_1, k, 1.0)  # a nanosecond apart, and no other topic
    assert pairing.counts.samples >= 1_900


def test_without_measured_pressures_the_commands_alone_are_a_sample() -> None:
    pairing = SamplePairing(0.02, Clock(), topics=(VOLTAGES,))
    (one,) = pairing.add(VOLTAGES, MS, 3e5, 4e5)
    assert (one.stamp_ns, one.voltage_1, one.voltage_2) == (MS, 3e5, 4e5)
    assert math.isnan(one.pressure_1) and math.isnan(one.pressure_2)
    assert pairing.counts.incomplete == 0


def test_a_measured_angle_is_a_fourth_topic_of_a_sample() -> None:
    clock = Clock()
    pairing = SamplePairing(0.02, clock, topics=(PRESSURE_1, PRESSURE_2, VOLTAGES, ANGLE))
    assert (
        pairing.add(PRESSURE_1, MS, 1.0)
        == pairing.add(PRESSURE_2, MS, 2.0)
        == pairing.add(VOLTAGES, MS, 3.0, 4.0)
        == []
    )
    assert pairing.add(ANGLE, MS, 0.1) == [Sample(MS, 1.0, 2.0, 3.0, 4.0, 0.1)]
    for topic, *values in ((PRESSURE_1, 1.0), (PRESSURE_2, 2.0), (VOLTAGES, 3.0, 4.0)):
        assert pairing.add(topic, 2 * MS, *values) == []
    assert [s.stamp_ns for s in pairing.add(ANGLE, 3 * MS, 0.2)] == [2 * MS]
    assert pairing.counts.incomplete == 1
