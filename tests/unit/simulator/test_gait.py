"""Sensor readings of a walking person's phone: what a step detector, a compass and a gyroscope filter rely on."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from services.simulator.phones.carrying import Carrying, CarryingParameters
from services.simulator.phones.gait import GRAVITY, InertialSamples, PhoneSensors, SensorParameters

RATE = 50
NORTH = math.pi / 2
PERFECT = SensorParameters(
    gyro_bias=0,
    gyro_drift=0,
    gyro_noise=0,
    accelerometer_bias=0,
    accelerometer_noise=0,
    pocket_noise=0,
    compass_bias=0,
    compass_noise=0,
)
QUIET = CarryingParameters(fidget_every=0)


def sensors(
    carrying: Carrying = "hand",
    seed: int = 1,
    own: SensorParameters | None = None,
    habits: CarryingParameters = QUIET,
    rate: float = RATE,
) -> PhoneSensors:
    return PhoneSensors(np.random.default_rng(seed), carrying, rate, own, None, habits)


def sample(
    phone: PhoneSensors,
    heading: np.ndarray,
    speed: np.ndarray,
    north: float = NORTH,
    start: float = 0.0,
    walked: float = 0.0,
    rate: float = RATE,
) -> InertialSamples:
    t = start + np.arange(len(speed)) / rate
    field = np.array([22.5 * math.cos(north), 22.5 * math.sin(north), -42.4])
    return phone.sample(t, heading, speed, walked + np.cumsum(speed) / rate, np.tile(field, (len(t), 1)))


def walk(seconds: float, speed: float, heading: float, rate: float = RATE) -> tuple[np.ndarray, np.ndarray]:
    n = int(seconds * rate)
    return np.full(n, heading), np.full(n, speed)


def compass_heading(samples: InertialSamples, part: slice = slice(None)) -> float:
    """Clockwise from north, radians, of the phone's y axis: tilt-compensated, as phones do it."""
    up = samples.acceleration[part].mean(axis=0)
    up /= np.linalg.norm(up)
    east = np.cross(samples.field[part].mean(axis=0), up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    return math.atan2(east[1], north[1])


@pytest.mark.parametrize("north_deg", [90.0, 0.0, 37.0, -120.0])
@pytest.mark.parametrize("clockwise", [0.0, 90.0])
def test_the_compass_reads_the_walk_clockwise_from_north_but_for_the_grip(north_deg: float, clockwise: float) -> None:
    """The one trap of headings: plans count counter-clockwise from x, compasses clockwise from north."""
    north = math.radians(north_deg)
    for seed in range(6):
        found = sample(sensors(seed=seed, own=PERFECT), *walk(20, 1.2, north - math.radians(clockwise)), north=north)
        wanted = clockwise - math.degrees(found.carried.offset[0])
        off = math.remainder(math.degrees(compass_heading(found)) - wanted, 360.0)
        assert off == pytest.approx(0.0, abs=5.0)  # a hand that yields


@pytest.mark.parametrize("carrying", ["hand", "pocket", "mixed"])
def test_integrating_the_gyroscope_gives_the_attitude_back(carrying: Carrying) -> None:
    rng = np.random.default_rng(5)
    heading = np.cumsum(rng.normal(0.0, 0.02, 3000))
    speed = np.clip(1.0 + np.cumsum(rng.normal(0.0, 0.02, 3000)), 0.0, 1.8)
    phone = sensors(carrying, own=PERFECT, habits=CarryingParameters(in_hand=10, in_pocket=10, fidget_every=5))
    parts = [
        sample(phone, heading[k : k + 250], speed[k : k + 250], start=k / RATE) for k in range(0, len(heading), 250)
    ]
    rotation, attitude = (np.concatenate([getattr(p, name) for p in parts]) for name in ("rotation", "attitude"))
    found = Rotation.from_matrix(attitude[0])
    for step in Rotation.from_rotvec(rotation[1:] / RATE):
        found = found * step
    assert (found.inv() * Rotation.from_matrix(attitude[-1])).magnitude() < 1e-6
    np.testing.assert_allclose(np.linalg.det(attitude), 1.0, atol=1e-9)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
@pytest.mark.parametrize("speed", [0.8, 1.3])
def test_the_norm_has_its_peak_at_the_persons_own_cadence_with_real_amplitude(carrying: Carrying, speed: float) -> None:
    phone = sensors(carrying)
    samples = sample(phone, *walk(60, speed, 0.3))
    norm = np.linalg.norm(samples.acceleration, axis=1)
    spectrum = np.abs(np.fft.rfft(norm - norm.mean()))
    frequency = np.fft.rfftfreq(len(norm), 1 / RATE)
    smooth = np.convolve(spectrum, np.ones(5) / 5, "same")
    assert frequency[smooth.argmax()] == pytest.approx(phone.stride.cadence(np.array([speed]))[0], abs=0.15)
    assert 0.7 < np.std(norm) * math.sqrt(2) < 4.5


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_standing_still_there_is_gravity_and_noise_only(carrying: Carrying) -> None:
    samples = sample(sensors(carrying), *walk(20, 0.0, 0.3))
    norm = np.linalg.norm(samples.acceleration, axis=1)
    assert norm.mean() == pytest.approx(GRAVITY, abs=0.15)
    assert norm.std() < 0.15
    assert not len(samples.steps.t)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_who_stands_still_turns_the_phone_slowly_and_no_faster_where_it_is_sampled_more_often(
    carrying: Carrying,
) -> None:
    """An angle without a rate would be white noise to the gyroscope, and more of it at every higher sampling rate."""
    turning, yields = [], []
    for rate in (50.0, 100.0, 200.0):
        found = [
            sample(sensors(carrying, seed, PERFECT, rate=rate), *walk(300, 0.0, 0.3, rate), rate=rate)
            for seed in range(8)
        ]
        turning.append(np.std([one.rotation for one in found]))
        # In the body's axes: how far the mount is turned from where it was put.
        relative = np.concatenate([one.attitude @ one.carried.mount.transpose(0, 2, 1) for one in found])
        yields.append(np.std(Rotation.from_matrix(relative).as_rotvec(), axis=0).mean())
    assert max(turning) < 0.1
    assert max(turning) < 1.1 * min(turning)
    np.testing.assert_allclose(np.degrees(yields), 2.5, rtol=0.1)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_fidgets_turn_the_phone_as_fast_as_people_do(carrying: Carrying) -> None:
    restless = CarryingParameters(fidget_every=1.0, fidget_for=(10.0, 20.0))
    found = [sample(sensors(carrying, seed, PERFECT, restless), *walk(120, 0.0, 0.3)) for seed in range(8)]
    turning = np.concatenate([np.linalg.norm(one.rotation[one.carried.fidget > 0.9], axis=1) for one in found])
    assert np.quantile(turning, 0.9) < 3.0
    assert np.median(turning) > 0.3


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_fidgeting_shakes_the_phone_as_hard_as_walking_and_takes_no_step(carrying: Carrying) -> None:
    restless = CarryingParameters(fidget_every=1.0, fidget_for=(10.0, 20.0))
    samples = sample(sensors(carrying, habits=restless), *walk(120, 0.0, 0.3))
    fidgets = samples.carried.fidget > 0.9
    assert fidgets.mean() > 0.5
    assert np.linalg.norm(samples.acceleration[fidgets], axis=1).std() > 0.4
    assert not len(samples.steps.t)


def test_the_gyroscope_turns_with_the_body_and_agrees_with_the_compass() -> None:
    heading = np.concatenate([np.zeros(250), np.linspace(0, math.pi / 2, 100), np.full(250, math.pi / 2)])
    samples = sample(sensors(own=PERFECT), heading, np.full(600, 1.1))
    up = samples.acceleration.mean(axis=0) / np.linalg.norm(samples.acceleration.mean(axis=0))
    turned = (samples.rotation[240:370] @ up).sum() / RATE
    assert turned == pytest.approx(math.pi / 2, abs=0.2)
    before, after = compass_heading(samples, slice(0, 200)), compass_heading(samples, slice(400, 600))
    assert math.remainder(before - after, math.tau) == pytest.approx(math.pi / 2, abs=0.2)


def test_gyroscopes_have_a_bias_of_their_own_that_wanders_within_minutes() -> None:
    own = SensorParameters(gyro_bias=0.01, gyro_drift=0.005, gyro_noise=0.0)
    constant, moved = [], []
    for seed in range(40):
        phone = sensors(seed=seed, own=own)
        parts = [sample(phone, *walk(5, 0.0, 0.0), start=5.0 * k).rotation.mean(axis=0) for k in range(120)]
        constant.append(np.mean(parts[:3], axis=0))
        moved.append(np.mean(parts[-3:], axis=0) - np.mean(parts[:3], axis=0))
    assert np.std(constant) == pytest.approx(math.hypot(0.01, 0.005), rel=0.25)
    assert 0.003 < np.std(moved) < 0.012


def test_stretches_join_without_a_jolt() -> None:
    phone = sensors()
    parts = [sample(phone, *walk(1, 1.2, 0.3), start=float(k), walked=1.2 * k) for k in range(10)]
    norm = np.concatenate([np.linalg.norm(part.acceleration, axis=1) for part in parts])
    rotation = np.concatenate([part.rotation for part in parts])
    jumps = np.abs(np.diff(norm))
    joints = np.arange(RATE - 1, len(norm) - 1, RATE)
    assert jumps[joints].mean() < 2 * jumps.mean()
    assert np.abs(rotation).max() < 1.0


def test_same_seed_same_readings_and_other_people_other_gaits() -> None:
    first, second = (sample(sensors(seed=3), *walk(2, 1.2, 0.3)) for _ in range(2))
    assert first.acceleration.tobytes() == second.acceleration.tobytes()
    assert len({sensors(seed=seed).gait.vertical for seed in range(20)}) == 20


def test_one_more_fidget_changes_no_step() -> None:
    restless = CarryingParameters(fidget_every=2.0)
    heading, speed = np.zeros(3000), np.where(np.arange(3000) % 600 < 300, 1.2, 0.0)
    quiet, shaken = (sample(sensors(habits=habits), heading, speed) for habits in (QUIET, restless))
    assert shaken.carried.fidget.any()
    np.testing.assert_array_equal(quiet.steps.t, shaken.steps.t)
