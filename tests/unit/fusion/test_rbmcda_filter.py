"""The identity filter's arrays against plain loops on filterpy, and its parts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from rbmcda_oracle import Target, one_cycle

from services.fusion.rbmcda.association import composites_of, linked_to
from services.fusion.rbmcda.births import birth
from services.fusion.rbmcda.filter_cycle import run_cycle
from services.fusion.rbmcda.particles import Cycle, Draws, Particles
from services.fusion.rbmcda.resampling import effective, systematic
from services.fusion.rbmcda.settings import RbmcdaSettings

POINTS = np.array([[0.0, 0.0, 2.8], [10.0, 0.0, 2.8], [5.0, 9.0, 2.8]])
BIAS = np.diag([9.0, 9.0, 9.0]) + 9.0
USUAL = np.array([1.0, -2.0, 0.5])
GRID = np.stack(np.meshgrid(np.arange(0.5, 10.0), np.arange(0.5, 9.0)), axis=-1).reshape(-1, 2)


def expected(places: np.ndarray) -> np.ndarray:
    apart = np.concatenate([places, np.full((len(places), 1), 1.1)], axis=1)[:, None] - POINTS
    level: np.ndarray = -40.0 - 22.0 * np.log10(np.linalg.norm(apart, axis=2))
    return level


def looked_at(places: np.ndarray) -> np.ndarray:
    return ((places[:, 0] > 1.0) & (places[:, 0] < 9.0)).astype(float)


def one_device(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    reading = expected(rng.uniform(2, 8, (1, 2)))[0] + rng.normal(0, 3, 3)
    return birth(GRID, expected(GRID), reading, np.full(3, 9.0), BIAS, USUAL)[:2]


def a_cycle(rng: np.random.Generator, number: int, devices: int, links: np.ndarray) -> Cycle:
    places = rng.uniform(1, 9, (4, 2))
    reading = expected(rng.uniform(2, 8, (devices, 2))).T + rng.normal(0, 3, (3, devices))
    reading[rng.random((3, devices)) < 0.1] = np.nan
    noise = np.full((3, devices), 9.0)
    anew = {
        k: birth(GRID, expected(GRID), reading[:, k], noise[:, k], BIAS, USUAL)
        for k in range(devices)
        if np.isfinite(reading[:, k]).any()
    }
    return Cycle(
        t=float(number),
        shift=rng.normal(0, 0.5, (2, devices)),
        owed=rng.normal(0, 0.2, (2, devices)),
        spread=np.repeat(np.array([[0.1, 0.02], [0.02, 0.2]])[:, :, None], devices, axis=2),
        haste=np.zeros(devices),
        kept=rng.uniform(0.7, 1.0, devices),
        usual=USUAL,
        bias=BIAS,
        reading=reading,
        noise=noise,
        expected=expected,
        places=places,
        place_noise=np.repeat(np.array([[0.05, 0.01], [0.01, 0.04]])[None], 4, axis=0),
        link=links,
        switched=rng.uniform(0.01, 0.1, 4),
        favour=rng.uniform(0.2, 2.0, (devices, 4)),
        pickup=rng.uniform(0.2, 1.0, 4),
        detection=rng.uniform(0.3, 0.9, devices),
        in_view=looked_at,
        density=0.05,
        anew=anew,
    )


@pytest.mark.parametrize("separate", [True, False])
def test_arrays_and_loops_agree(separate: bool) -> None:
    """Eight cycles of the same draws, with births, deaths, jumps and resampling: states, weights and links to 1e-9."""
    rng = np.random.default_rng(7)
    # A gate so wide that the loops, which have none, see the same.
    settings = RbmcdaSettings(particles=12, jump=0.1, jump_unseen=0.2, separate=separate, gate=1e3)
    particles = Particles.empty(12, 3)
    plain: list[list[Target]] = [[] for _ in range(12)]
    resampled = 0
    for number in range(8):
        for _ in range(2 if number == 0 else int(number in (3, 5))):
            mean, covariance = one_device(rng)
            particles = particles.with_device(mean, covariance)
            for particle in plain:
                shared = particle[0].weight if particle and not separate else 1.0 / 12
                particle.append(Target(mean.copy(), covariance.copy(), shared))
        if number == 6:
            particles = particles.without(1)
            for particle in plain:
                del particle[1]
        devices = len(plain[0])
        cycle = a_cycle(rng, number, devices, rng.permutation(4) + 2 * (number % 2))
        draws = Draws.of(rng, 12, devices)
        particles, estimate = run_cycle(particles, cycle, settings, draws)
        resampled += int((effective(estimate.weight) < 6.0).sum())
        assert estimate.seen_as.tolist() == one_cycle(plain, cycle, settings, draws)
        for k in range(devices):
            mean, covariance = np.array([p[k].x for p in plain]), np.array([p[k].spread for p in plain])
            held = particles.state[:, k]
            np.testing.assert_allclose(particles.mean[:, held].T, mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(
                np.moveaxis(particles.covariance[:, :, held], 2, 0), covariance, rtol=1e-9, atol=1e-9
            )
            np.testing.assert_allclose(particles.weight[:, k], [p[k].weight for p in plain], rtol=1e-8, atol=1e-12)
            assert particles.link[:, k].tolist() == [p[k].link for p in plain]
    assert resampled


def test_systematic_resampling_takes_each_as_often_as_it_weighs() -> None:
    weights = np.array([[0.5, 0.0], [0.25, 0.0], [0.25, 0.0], [0.0, 1.0]])
    assert effective(weights) == pytest.approx([1.0 / 0.375, 1.0])
    assert systematic(weights, np.array([0.5, 0.1])).T.tolist() == [[0, 0, 1, 2], [3, 3, 3, 3]]


def test_a_new_device_is_where_its_first_scan_says() -> None:
    """With radio constants known, the mean lies near; with constants unknown, it is honestly vaguer."""
    place = np.array([[7.0, 3.0]])
    reading = expected(place)[0]
    sure, narrow, _ = birth(GRID, expected(GRID), reading, np.full(3, 1.0), np.zeros((3, 3)), np.zeros(3))
    _, vague, _ = birth(GRID, expected(GRID), reading, np.full(3, 1.0), BIAS, np.zeros(3))
    assert math.dist(sure[:2], place[0]) < 0.5
    assert np.trace(vague[:2, :2]) > 4.0 * np.trace(narrow[:2, :2])


def test_particles_share_the_filter_of_a_history() -> None:
    """A hundred particles that see a device as one of four people or not, or begin anew, hold ten states of it."""
    rng = np.random.default_rng(3)
    particles = Particles.empty(100, 3).with_device(*one_device(rng)).with_device(*one_device(rng))
    cycle = a_cycle(rng, 0, 2, np.arange(4))
    after, estimate = run_cycle(particles, cycle, RbmcdaSettings(jump=0.1, gate=1e3), Draws.of(rng, 100, 2))
    assert after.mean.shape[1] <= 2 * 2 * 5
    assert len(np.unique(estimate.seen_as)) > 1
    assert not set(after.state[:, 0].tolist()) & set(after.state[:, 1].tolist())


def test_a_scan_alone_moves_nobody_where_it_is_no_correction() -> None:
    """Where no camera looks, a device is where its steps led, whether it began anew on the way or not."""
    rng = np.random.default_rng(4)
    mean, covariance = one_device(rng)
    cycle = a_cycle(rng, 0, 1, np.arange(4))
    dark = replace(
        cycle,
        places=np.zeros((0, 2)),
        place_noise=np.zeros((0, 2, 2)),
        link=np.zeros(0, int),
        switched=np.zeros(0),
        favour=np.ones((1, 0)),
        pickup=np.ones(0),
    )
    before = Particles.empty(20, 3).with_device(mean, covariance)
    settings = RbmcdaSettings(jump=0.5, jump_unseen=0.5, radio_only=False, resample_below=0.0)
    after, _ = run_cycle(before, dark, settings, Draws.of(rng, 20, 1))
    moved = (mean[:2] + cycle.shift[:, 0] + cycle.owed[:, 0])[:, None, None]
    np.testing.assert_allclose(after.positions()[0], np.broadcast_to(moved, (2, 20, 1)))
    corrected, _ = run_cycle(before, dark, replace(settings, radio_only=True), Draws.of(rng, 20, 1))
    assert np.abs(corrected.positions()[0] - moved).min() > 1e-3


def test_a_state_far_off_makes_no_composites_for_the_others() -> None:
    mean = np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    covariance = np.eye(2)[:, :, None] * np.array([0.04, 0.04, 25.0])
    places, noise = np.array([[0.2, 0.0], [9.0, 0.0], [50.0, 0.0]]), np.repeat(0.01 * np.eye(2)[None], 3, axis=0)
    (found,) = composites_of(mean, covariance, np.array([0, 3]), places, noise, 4.0)
    assert found.sighting.tolist() == [0, 1]
    assert (found.likelihood > 0.0).tolist() == [[True, True, True], [False, False, True]]
    wide = math.exp(-0.5 * (9.0**2 + 0.1**2) / 25.01) / (2.0 * math.pi * 25.01)
    assert found.likelihood[1, 2] == pytest.approx(wide)


def test_who_is_linked_to_which_sighting() -> None:
    assert linked_to(np.array([7, 3, 9]), np.array([[3, -1], [9, 4]])).tolist() == [[1, -1], [2, -1]]
    assert linked_to(np.zeros(0, int), np.array([[3]])).tolist() == [[-1]]
