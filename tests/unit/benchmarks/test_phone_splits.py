"""Who teaches is not who is tested, and neither is the time; phones are on whom the experiment says."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.eth_phones import eth_halves
from benchmarks.eth_recording import FRAMES_PER_S, eth_carriers, eth_recording
from benchmarks.pets_phones import pets_folds, pets_whole
from benchmarks.phone_folds import Split


def heard(split: Split, *, teach: bool) -> tuple[set[str], float, float]:
    """Return which devices were heard, from when to when."""
    record = split.teach if teach else split.test
    assert record is not None
    told = [scan for scans in record.scans.values() for scan in scans]
    return {scan.device for scan in told}, min(scan.t for scan in told), max(scan.t for scan in told)


@pytest.fixture(scope="module")
def folds(data_folder: Path) -> list[Split]:
    return pets_folds(1)


@pytest.fixture(scope="module")
def halves(data_folder: Path) -> list[Split]:
    return eth_halves(1)


def test_on_the_clip_other_people_teach_in_another_time(folds: list[Split]) -> None:
    for split in folds:
        assert split.devices is not None
        teachers, first, last = heard(split, teach=True)
        _, begin, end = heard(split, teach=False)
        assert not teachers & set(split.devices)
        assert last < begin or first > split.start + (end - split.start) * 0.9


def test_on_the_clip_everybody_is_scored_once_in_either_half(folds: list[Split]) -> None:
    scored = [(device, split.start) for split in folds for device in split.devices or ()]
    assert len(scored) == len(set(scored)) == 2 * 19


def test_on_the_whole_clip_everybody_carries_a_phone(data_folder: Path) -> None:
    [whole] = pets_whole(1)
    assert len(whole.test.truth.carriers()) == 19
    assert len(whole.test.frames) == 795


def test_on_the_pavement_nobody_who_teaches_is_tested(halves: list[Split]) -> None:
    [split] = halves
    assert split.teach is not None
    teachers, _, taught = heard(split, teach=True)
    _, begin, _ = heard(split, teach=False)
    assert taught < begin < split.start
    truth = split.test.truth
    shown = np.unique(np.nonzero(truth.in_view[truth.t >= split.start])[1]).tolist()
    tested = {truth.device[person] for person in shown}
    assert len(teachers) > 20
    assert not teachers & tested


def test_on_the_pavement_a_fifth_carry_phones_and_half_of_them_walk_in_company(data_folder: Path) -> None:
    carriers = eth_carriers(1)
    assert len(carriers) == len(set(carriers)) == 72
    lines = (data_folder / "eth-walking" / "seq_eth" / "groups.txt").read_text().splitlines()
    groups = [set(line.split()) for line in lines if len(set(line.split())) > 1]
    in_company = [one for one in carriers if any(one in group for group in groups)]
    assert len(in_company) == 36
    assert carriers != eth_carriers(2)


def test_made_detections_follow_the_marked_people(data_folder: Path) -> None:
    recording = eth_recording()
    known = np.isfinite(recording.position[..., 0])
    seen = sum(len(frame.x) for frame in recording.frames)
    assert seen == pytest.approx(0.92 * known.sum() + 0.1 * len(recording.frames), rel=0.03)
    assert np.diff([frame.t for frame in recording.frames]) == pytest.approx(1.0 / FRAMES_PER_S)
    number = int(np.argmax(known.sum(axis=1)))
    places = recording.position[number, known[number]]
    frame = recording.frames[number]
    detections = np.column_stack([frame.x, frame.y])
    nearest = np.linalg.norm(detections[:, None] - places[None], axis=2).min(axis=1)
    assert np.median(nearest) < 0.25
