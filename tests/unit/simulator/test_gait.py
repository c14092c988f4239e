"""Sensor readings of a walking person's phone: what a step detector, a compass and a gyroscope filter rely on."""

import math

import numpy as np
import pytest
from scipy.signal import butter, find_peaks, sosfilt

from services.simulator.gait import GRAVITY, Gait, PhoneSensors, step_frequency

RATE = 50


def sensors(north: float = math.pi / 2, carrying: str = "hand", seed: int = 1) -> PhoneSensors:
    return PhoneSensors(np.random.default_rng(seed), north, carrying)  # type: ignore[arg-type]


def walk(seconds: float, speed: float, heading: float) -> tuple[np.ndarray, np.ndarray]:
    n = int(seconds * RATE)
    return np.full(n, heading), np.full(n, speed)


def compass_heading(acceleration: np.ndarray, field: np.ndarray) -> float:
    """Clockwise from north, radians, of the phone's y axis: tilt-compensated, as phones do it."""
    up = acceleration.mean(axis=0) / np.linalg.norm(acceleration.mean(axis=0))
    east = np.cross(field.mean(axis=0), up)
    east /= np.linalg.norm(east)
    north = np.cross(up, east)
    return math.atan2(east[1], north[1])


@pytest.mark.parametrize("north_deg", [90.0, 0.0, 37.0, -120.0])
def test_walking_to_plan_north_the_compass_reads_zero(north_deg: float) -> None:
    north = math.radians(north_deg)
    readings = []
    for seed in range(12):  # each holds the phone a little turned: on average it points along the walk
        samples = sensors(north, seed=seed).sample(*walk(20, 1.2, north))
        readings.append(compass_heading(samples.acceleration, samples.field))
    assert math.degrees(np.mean(readings)) == pytest.approx(0.0, abs=5.0)


def test_walking_east_of_north_the_compass_reads_ninety_clockwise() -> None:
    readings = []
    for seed in range(12):
        samples = sensors(seed=seed).sample(*walk(20, 1.2, 0.0))
        readings.append(compass_heading(samples.acceleration, samples.field))
    assert math.degrees(np.mean(readings)) == pytest.approx(90.0, abs=5.0)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
@pytest.mark.parametrize("speed", [0.8, 1.3])
def test_the_norm_has_its_peak_at_the_step_frequency_with_real_amplitude(carrying: str, speed: float) -> None:
    phone = sensors(carrying=carrying)
    samples = phone.sample(*walk(60, speed, 0.3))
    norm = np.linalg.norm(samples.acceleration, axis=1)
    spectrum = np.abs(np.fft.rfft(norm - norm.mean()))
    frequency = np.fft.rfftfreq(len(norm), 1 / RATE)
    expected = step_frequency(phone.gait, np.array([speed]))[0]
    smooth = np.convolve(spectrum, np.ones(5) / 5, "same")
    assert frequency[smooth.argmax()] == pytest.approx(expected, abs=0.15)
    assert 0.7 < np.std(norm) * math.sqrt(2) < 4.0


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_a_band_pass_peak_detector_counts_the_steps(carrying: str) -> None:
    for seed in range(4):
        samples = sensors(carrying=carrying, seed=seed).sample(*walk(60, 1.1, 0.3))
        norm = np.linalg.norm(samples.acceleration, axis=1)
        band = sosfilt(butter(2, (0.6, 2.6), "bandpass", fs=RATE, output="sos"), norm - GRAVITY)
        peaks, _ = find_peaks(band, height=0.3, distance=int(0.28 * RATE))
        assert len(peaks) == pytest.approx(samples.steps[-1], rel=0.05)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_standing_still_there_is_gravity_and_noise_only(carrying: str) -> None:
    samples = sensors(carrying=carrying).sample(*walk(20, 0.05, 0.3))
    norm = np.linalg.norm(samples.acceleration, axis=1)
    assert norm.mean() == pytest.approx(GRAVITY, abs=0.05)
    assert norm.std() < 0.2
    assert samples.steps[-1] == 0


def test_the_gyroscope_turns_with_the_body_and_agrees_with_the_compass() -> None:
    heading = np.concatenate([np.zeros(250), np.linspace(0, math.pi / 2, 100), np.full(250, math.pi / 2)])
    phone = sensors()
    samples = phone.sample(heading, np.full(600, 1.1))
    up = np.array([samples.acceleration[:200].mean(axis=0), samples.acceleration[-200:].mean(axis=0)]).mean(axis=0)
    up /= np.linalg.norm(up)
    bias = samples.rotation[:200].mean(axis=0)
    turned = ((samples.rotation[240:360] - bias) @ up).sum() / RATE
    assert turned == pytest.approx(math.pi / 2, abs=0.15)
    before = compass_heading(samples.acceleration[:200], samples.field[:200])
    after = compass_heading(samples.acceleration[-200:], samples.field[-200:])
    assert math.remainder(before - after, math.tau) == pytest.approx(math.pi / 2, abs=0.15)


def test_stretches_join_without_a_jolt() -> None:
    phone = sensors()
    parts = [phone.sample(*walk(1, 1.2, 0.3)) for _ in range(10)]
    norm = np.concatenate([np.linalg.norm(part.acceleration, axis=1) for part in parts])
    rotation = np.concatenate([part.rotation for part in parts])
    jumps = np.abs(np.diff(norm))
    joints = np.arange(RATE - 1, len(norm) - 1, RATE)
    assert jumps[joints].max() <= jumps.max()
    assert jumps[joints].mean() < 2 * jumps.mean()
    assert np.abs(rotation).max() < 1.0


def test_same_seed_same_readings_and_other_people_other_strides() -> None:
    first, second = (sensors(seed=3).sample(*walk(2, 1.2, 0.3)) for _ in range(2))
    assert first.acceleration.tobytes() == second.acceleration.tobytes()
    strides = [1.3 / Gait.draw(np.random.default_rng(seed)).cadence for seed in range(50)]
    assert 0.03 < np.std(strides) / np.mean(strides) < 0.1
