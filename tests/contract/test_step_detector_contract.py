"""What every step detector must keep to."""

import dataclasses
import pickle

import numpy as np
import pytest

from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.steps.detector import LONGEST_DELAY, StepDetector
from services.gateway.steps.detectors import DETECTORS, SHIPPED

REST = 8.0
FIRST = 1_000_000_000.0


@pytest.fixture(params=sorted(DETECTORS))
def detector(request: pytest.FixtureRequest) -> StepDetector:
    return DETECTORS[request.param]()


def walk(cadence: float, seconds: float = 24.0, seed: int = 3, strength: float = 1.0) -> np.ndarray:
    """Rest, walk, rest, (n, 3): in a phone held askew; the two feet differ a little."""
    rng = np.random.default_rng(seed)
    t = np.arange(int((seconds + 2 * REST) * RATE)) / RATE
    phase = 2 * np.pi * cadence * (t - REST)
    wave = 2.5 * np.cos(phase) + 0.3 * np.cos(0.5 * phase) + 0.6 * np.cos(2 * phase + 0.5)
    walking = (t >= REST) & (t < REST + seconds)
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    return (9.81 + strength * wave * walking)[:, None] * up + rng.normal(0, 0.08, (len(t), 3))


def hops_of(phones: list[np.ndarray], count: dict[int, int] | None = None) -> list[Hops]:
    """Cut recordings of one length, (n, 3) each, to hops; ``count`` says of which hop how much was measured."""
    p, hops = len(phones), len(phones[0]) // HOP
    stacked = np.stack(phones)
    return [
        Hops(
            t=np.full(p, FIRST + hop * HOP / RATE),
            count=np.full(p, (count or {}).get(hop, HOP)),
            fresh=np.full(p, hop == 0),
            acceleration=stacked[:, hop * HOP : (hop + 1) * HOP],
            rotation=np.zeros((p, HOP, 3)),
            field=np.full((p, HOP, 3), np.nan),
        )
        for hop in range(hops)
    ]


def steps_of(detector: StepDetector, hops: list[Hops]) -> list[np.ndarray]:
    p = len(hops[0].t)
    state = np.zeros(p, detector.STATE)
    told: list[list[float]] = [[] for _ in range(p)]
    for hop in hops:
        steps = detector.advance(state, hop)
        for phone, t in zip(steps.phone, steps.t, strict=True):
            told[phone].append(t)
    return [np.array(t) for t in told]


@pytest.mark.parametrize("cadence", [1.5, 1.8, 2.1])
def test_counts_a_steady_walk_to_within_two_steps(detector: StepDetector, cadence: float) -> None:
    seconds = 24.0
    (told,) = steps_of(detector, hops_of([walk(cadence, seconds)]))
    inside = told[(told > FIRST + REST - 1.0) & (told < FIRST + REST + seconds + 1.0)]
    # The adaptive window is cut to whole steps: what is left at the end, to six seconds, it cannot tell.
    lost = 6.0 * cadence if type(detector).__name__ == "AdaptiveDft" else 0.0
    assert cadence * seconds - 2 - lost <= len(inside) <= len(told) <= cadence * seconds + 2
    assert np.all(np.diff(told) > 0.2)


def test_many_phones_at_once_find_what_each_finds_alone(detector: StepDetector) -> None:
    phones = [walk(1.6, seed=1), walk(2.0, seed=2), np.tile([0.0, 0.0, 9.81], (2000, 1)), walk(1.8, seed=4)]
    together = steps_of(detector, hops_of(phones))
    assert [len(told) > 20 for told in together] == [True, True, False, True]
    for phone, told in zip(phones, together, strict=True):
        np.testing.assert_allclose(steps_of(detector, hops_of([phone]))[0], told, atol=1e-6)
    for told, reversed_ in zip(together, steps_of(detector, hops_of(phones[::-1]))[::-1], strict=True):
        np.testing.assert_allclose(reversed_, told, atol=1e-6)


def test_tells_steps_in_order_neither_late_nor_in_the_future(detector: StepDetector) -> None:
    phones = [walk(1.6, seed=1), walk(2.0, seed=2, strength=0.6)]
    state = np.zeros(2, detector.STATE)
    newest = np.full(2, -np.inf)
    for hop in hops_of(phones):
        steps = detector.advance(state, hop)
        assert np.all(np.diff(steps.phone) >= 0)
        end = hop.t[0] + HOP / RATE
        assert np.all((steps.t > end - LONGEST_DELAY) & (steps.t <= end))
        for phone in range(2):
            t = steps.t[steps.phone == phone]
            assert np.all(np.diff(t, prepend=newest[phone]) > 0.0)
            newest[phone] = t[-1] if len(t) else newest[phone]
    assert np.isfinite(newest).all()


def test_zeros_are_a_phone_of_whom_nothing_is_known(detector: StepDetector) -> None:
    hops = hops_of([walk(1.8)])
    state = np.zeros(1, detector.STATE)
    for hop in hops[:20]:
        detector.advance(state, hop)
    state[:] = np.zeros((), detector.STATE)
    after = [detector.advance(state, hop) for hop in hops[20:]]
    (alone,) = steps_of(detector, hops[20:])
    np.testing.assert_allclose(np.concatenate([steps.t for steps in after]), alone, atol=1e-9)
    assert len(alone) > 5


def test_a_phone_on_the_table_takes_no_steps(detector: StepDetector) -> None:
    still = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(5).normal(0, 0.08, (1500, 3))
    state = np.zeros(1, detector.STATE)
    for hop in hops_of([still]):
        steps = detector.advance(state, hop)
        assert len(steps.t) == 0
        assert not steps.walking.any()
        assert not steps.period.any()


def test_tells_walking_and_the_period_and_stops(detector: StepDetector) -> None:
    cadence, seconds = 1.8, 24.0
    state = np.zeros(1, detector.STATE)
    for hop in hops_of([walk(cadence, seconds)]):
        steps = detector.advance(state, hop)
        elapsed = hop.t[0] + HOP / RATE - FIRST
        if REST + 9.0 <= elapsed <= REST + seconds:
            assert steps.walking[0]
            assert steps.period[0] == pytest.approx(1.0 / cadence, rel=0.15)
    assert not steps.walking[0]
    assert steps.period[0] == 0.0


def test_what_follows_a_hole_leads_to_nothing(detector: StepDetector) -> None:
    """Only ``count`` samples of a hop are measured; what stands in for the others is no step."""
    measured = 10
    phone = walk(1.8)
    (hop,) = np.flatnonzero(np.arange(40) == 20)
    hops = hops_of([phone], {int(hop): measured})
    rest = hops[hop].acceleration.copy()
    rest[:, measured:] = rest[:, measured - 1 : measured]
    held = dataclasses.replace(hops[hop], acceleration=rest)
    (told,) = steps_of(detector, [*hops[:hop], held])
    assert not len(told) or told[-1] <= held.t[0] + measured / RATE
    wild = rest.copy()
    wild[:, measured:] = 40.0
    (other,) = steps_of(detector, [*hops[:hop], dataclasses.replace(held, acceleration=wild)])
    assert not len(other) or other[-1] <= held.t[0] + measured / RATE


def test_the_state_is_small_and_can_be_kept(detector: StepDetector) -> None:
    hops = hops_of([walk(1.8)])
    state = np.zeros(1, detector.STATE)
    for hop in hops[:15]:
        detector.advance(state, hop)
    assert len(pickle.dumps(state)) < 200_000
    kept = pickle.loads(pickle.dumps(state))
    for hop in hops[15:]:
        one, other = detector.advance(state, hop), detector.advance(kept, hop)
        np.testing.assert_array_equal(one.t, other.t)


def test_nothing_depends_on_when_the_clock_began(detector: StepDetector) -> None:
    """A phone's clock may count from its start or from 1970; the walk begins with the clock."""
    hops = hops_of([walk(1.8)[int(REST * RATE) :]])
    told = []
    for epoch in (0.0, 1.7e9):
        (steps,) = steps_of(detector, [dataclasses.replace(hop, t=hop.t - FIRST + epoch) for hop in hops])
        told.append(steps - epoch)
    assert len(told[0]) > 20
    np.testing.assert_allclose(told[0], told[1], atol=1e-5)


def test_every_way_of_carrying_has_a_detector() -> None:
    assert set(SHIPPED) == {"hand", "pocket", "bag", "unknown"}
    assert set(SHIPPED.values()) <= set(DETECTORS)
