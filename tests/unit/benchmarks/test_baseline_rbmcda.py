"""Sight alone with many guesses: Rao-Blackwellised Monte Carlo data association."""

from dataclasses import replace

import numpy as np
import pytest
from baseline_world import DEPTH, VIEW, WIDTH, SmallWorld, sighted
from filterpy.kalman import KalmanFilter
from scipy.stats import multivariate_normal

from benchmarks.baselines.sightings import Sightings
from benchmarks.baselines.vision_rbmcda import Particles, RbmcdaParameters, View, _cycles, track

NOISE = 0.25**2 * np.eye(2)


class Oracle:
    """The same filter as loops over particles and filterpy objects, slow and plain."""

    def __init__(self, parameters):
        self.chosen = parameters
        self.rng = np.random.default_rng(parameters.seed)
        self.particles = [[] for _ in range(parameters.particles)]  # lists of None or [id, filter, seen]
        self.weights = [1.0 / parameters.particles] * parameters.particles
        self.t, self.born = None, 0

    def scan(self, t, positions):
        chosen = self.chosen
        log_weights = []
        for weight, people in zip(self.weights, self.particles, strict=True):
            for place, person in enumerate(people):
                if person is None:
                    continue
                self.predict(person[1], t - self.t)
                x, y = person[1].x[:2]
                outside = max(-x, x - WIDTH, -y, y - DEPTH) > chosen.margin
                if t - person[2] > chosen.death or outside:
                    people[place] = None
            log_weights.append(np.log(weight) + sum(np.log(1 - chosen.detection) for p in people if p is not None))
        self.t = t
        events = [[None] * len(positions) for _ in self.particles]
        old = [[person is not None for person in people] for people in self.particles]
        for m in self.rng.permutation(len(positions)):
            draws = self.rng.random(chosen.particles)
            for i, people in enumerate(self.particles):
                densities = [
                    chosen.false_per_frame / (WIDTH * DEPTH),
                    chosen.births_per_s * chosen.cycle / (WIDTH * DEPTH),
                ]
                for place, was in enumerate(old[i]):
                    if not was or place in events[i]:
                        densities.append(0.0)
                        continue
                    kf = people[place][1]
                    spread = kf.H @ kf.P @ kf.H.T + NOISE
                    density = multivariate_normal(kf.x[:2], spread).pdf(positions[m])
                    densities.append(chosen.detection / (1 - chosen.detection) * density)
                total = sum(densities)
                log_weights[i] += np.log(total)
                draw, event = draws[i] * total, 0
                while draw >= densities[event]:
                    draw -= densities[event]
                    event += 1
                if event == 1:
                    self.bear(people, old[i], t, m, positions[m])
                elif event >= 2:
                    events[i][m] = event - 2
        self.born += len(positions)
        for people, event in zip(self.particles, events, strict=True):
            for m, place in enumerate(event):
                if place is not None:
                    people[place][1].update(positions[m])
                    people[place][2] = t
        top = max(log_weights)
        weights = np.exp(np.array(log_weights) - top)
        self.weights = list(weights / weights.sum())
        self.answer = self.mixture()
        if 1.0 / sum(w * w for w in self.weights) < 0.5 * chosen.particles:
            self.resample()

    def predict(self, kf, dt):
        kf.F = np.eye(4) + dt * np.eye(4, k=2)
        kf.Q = np.kron(self.chosen.acceleration**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), np.eye(2))
        kf.predict()

    def bear(self, people, old, t, m, position):
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.x = np.array([*position, 0.0, 0.0])
        kf.P = np.diag([NOISE[0, 0], NOISE[1, 1], self.chosen.speed**2, self.chosen.speed**2])
        kf.H, kf.R = np.eye(2, 4), NOISE
        person = [self.born + m, kf, t]
        if None in people:
            people[people.index(None)] = person
        else:
            people.append(person)
            old.append(False)

    def mixture(self):
        exists, means = {}, {}
        for weight, people in zip(self.weights, self.particles, strict=True):
            for person in people:
                if person is not None:
                    exists[person[0]] = exists.get(person[0], 0.0) + weight
                    means[person[0]] = means.get(person[0], 0.0) + weight * person[1].x
        return {who: means[who] / share for who, share in exists.items() if share > 0.5}

    def resample(self):
        n = self.chosen.particles
        start, levels = self.rng.random(), np.cumsum(self.weights)
        chosen = [next(k for k in range(n) if k == n - 1 or levels[k] > (start + i) / n) for i in range(n)]
        self.particles = [[None if p is None else self.copy(p) for p in self.particles[k]] for k in chosen]
        self.weights = [1.0 / n] * n

    @staticmethod
    def copy(person):
        kf = KalmanFilter(dim_x=4, dim_z=2)
        kf.x, kf.P, kf.H, kf.R = person[1].x.copy(), person[1].P.copy(), np.eye(2, 4), NOISE
        return [person[0], kf, person[2]]


def test_it_is_the_plain_loop_over_particles_and_textbook_filters():
    rng = np.random.default_rng(8)
    chosen = RbmcdaParameters(particles=12, births_per_s=2.0, death=2.5, seed=3)
    ours, oracle = Particles(View(VIEW), chosen), Oracle(chosen)
    people = rng.uniform([1.0, 1.0], [WIDTH - 1, DEPTH - 1], (6, 2))
    velocity = rng.uniform(-0.8, 0.8, (6, 2))
    told = resampled = 0
    for t in range(15):
        seen = people[rng.random(6) < 0.7] + velocity[:1] * 0.0
        positions = np.concatenate([seen + rng.normal(0, 0.25, seen.shape), rng.uniform(0, 9, (rng.poisson(0.5), 2))])
        people = people + velocity
        ours.scan(float(t), positions, np.tile(NOISE, (len(positions), 1, 1)))
        oracle.scan(float(t), positions)
        np.testing.assert_allclose(ours.weight, oracle.weights, rtol=0, atol=1e-9)
        ids, states = ours.people()
        assert ids.tolist() == sorted(oracle.answer)
        for who, state in zip(ids.tolist(), states, strict=True):
            np.testing.assert_allclose(state, oracle.answer[who], rtol=0, atol=1e-9)
        told += len(ids)
        resampled += np.ptp(ours.weight) == 0.0
    assert told > 20
    assert resampled >= 2
    assert ours.identity.shape[1] > 4  # more people than the arrays began with


def frames(t, *people):
    return [
        sighted(float(now), [person[i] for person in people if np.isfinite(person[i]).all()]) for i, now in enumerate(t)
    ]


def line(t, start, velocity):
    return np.asarray(start, float) + np.asarray(t)[:, None] * np.asarray(velocity, float)


@pytest.fixture(scope="module")
def record():
    return SmallWorld(seed=6, duration=120.0).record()


def nearest(tracks, place, position):
    rows = tracks.at(place)
    return min(rows, key=lambda row: np.hypot(row[1] - position[0], row[2] - position[1]))


def test_two_people_apart_keep_their_ids_among_false_detections_and_misses(record):
    rng = np.random.default_rng(2)
    t = np.arange(60.0)
    one = np.stack([5.5 + 4.0 * np.cos(t / 8), 2.0 + np.sin(t / 8)], axis=1)
    two = np.stack([5.5 + 4.0 * np.sin(t / 8), 7.0 + np.cos(t / 8)], axis=1)
    seen = []
    for i, now in enumerate(t):
        true = [place[i] + rng.normal(0, 0.25, 2) for place in (one, two) if rng.random() < 0.85]
        seen.append(sighted(now, [*true, *rng.uniform([0, 0], [WIDTH, DEPTH], (rng.poisson(0.5), 2))]))
    tracks = track(replace(record, frames=seen), t)
    for person in (one, two):
        rows = [nearest(tracks, i, person[i]) for i in range(10, 60)]
        ids = [row[0] for row in rows]
        assert ids[0] == ids[-1]
        # Now and then a minority of particles, in which the same person is called by a later birth, is right for once.
        assert ids.count(ids[0]) >= 48
        errors = [np.hypot(row[1] - person[i + 10, 0], row[2] - person[i + 10, 1]) for i, row in enumerate(rows)]
        assert np.mean(errors) < 0.5
    # Hardly anybody else: some thirty false detections make no crowd.
    assert len(tracks.when) < 2.3 * 60


def test_nobody_is_made_of_false_detections_alone(record):
    rng = np.random.default_rng(1)
    seen = [sighted(t, rng.uniform([0, 0], [WIDTH, DEPTH], (rng.poisson(0.5), 2))) for t in range(300)]
    tracks = track(replace(record, frames=seen), np.arange(300.0))
    assert len(tracks.when) < 0.1 * 300


def test_somebody_hidden_is_carried_on_and_somebody_gone_is_forgotten(record):
    t = np.arange(40.0)
    person = line(t, (0.5, 4.5), (0.2, 0.0))
    hidden = person.copy()
    hidden[15:19] = np.nan
    hidden[26:] = np.nan
    tracks = track(replace(record, frames=frames(t, hidden)), t)
    ids = set(tracks.track.tolist())
    assert len(ids) == 1
    assert np.isin(np.arange(5, 26), tracks.when).all()
    assert np.hypot(*(np.array(nearest(tracks, 18, person[18])[1:]) - person[18])) < 0.6
    assert tracks.when.max() == 25 + RbmcdaParameters().death


def test_who_walks_out_of_view_is_gone_before_the_time_is_up(record):
    t = np.arange(30.0)
    person = line(t, (1.0, 4.5), (1.0, 0.0))
    person[person[:, 0] > WIDTH] = np.nan
    tracks = track(replace(record, frames=frames(t, person)), t)
    assert 10 <= tracks.when.max() <= 12


def test_newest_frame_of_each_cycle_is_used_and_answers_come_from_the_past(record):
    began = 1.7e9 + 0.1  # since the epoch, where 1 / 30 s has few digits left
    t = began + np.arange(600) / 30.0
    person = line(t - began, (0.5, 4.5), (0.4, 0.0))
    fast = frames(t, person)
    # Between the ends of cycles there is a second detection, which must not matter.
    slow = fast[::30]
    decoyed = [frame if i % 30 == 0 else sighted(frame.t, [(frame.x[0], frame.y[0] + 3.0)]) for i, frame in
               enumerate(fast)]  # fmt: skip
    times = began + np.arange(0.01, 18.9, 0.25)
    one, other = (track(replace(record, frames=chosen), times) for chosen in (slow, decoyed))
    np.testing.assert_array_equal(one.position, other.position)
    assert len(one.when) > 60
    cut = track(replace(record, frames=[frame for frame in fast if frame.t <= began + 10.01]), times)
    whole = track(replace(record, frames=fast), times)
    before = whole.when <= 40
    np.testing.assert_array_equal(whole.position[before], cut.position[cut.when <= 40])


def test_rounding_of_times_since_the_epoch_puts_no_two_frames_into_one_cycle():
    t = np.add.accumulate([1.7e9 + 0.1, *[0.2] * 500])
    sightings = Sightings.of([sighted(float(now), [(1.0, 1.0)]) for now in t])
    cycles = list(_cycles(sightings, 0.2))
    assert len(cycles) == 501
    assert all(len(rows) == 1 for _, rows in cycles)


def test_a_frame_late_for_the_end_of_its_cycle_costs_no_half_second(record):
    t = np.arange(0.0, 10.0, 0.5) + np.where(np.arange(20) % 4 == 2, 0.004, 0.0)
    person = line(t, (0.5, 4.5), (1.0, 0.0))
    tracks = track(replace(record, frames=frames(t, person)), t)
    errors = [abs(nearest(tracks, i, person[i])[1] - person[i, 0]) for i in range(6, 20)]
    assert max(errors) < 0.1


def test_same_seed_same_tracks_and_another_seed_others(record):
    times = record.truth.t
    one, same = track(record, times), track(record, times)
    other = track(record, times, RbmcdaParameters(seed=1))
    np.testing.assert_array_equal(one.position, same.position)
    np.testing.assert_array_equal(one.track, same.track)
    assert len(one.track) != len(other.track) or not np.array_equal(one.position, other.position)


def test_frames_without_anybody_and_records_without_frames(record):
    times = np.arange(5.0)
    assert len(track(replace(record, frames=[]), times).when) == 0
    assert len(track(replace(record, frames=[sighted(t, []) for t in range(5)]), times).when) == 0


def test_view_is_its_convex_hull_and_a_margin():
    view = View(np.array([[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0], [1.0, 1.0]]))
    assert view.area == pytest.approx(4.0)
    inside = view.holds(np.array([[1.0, 1.0], [2.9, 1.0], [3.1, 1.0], [1.0, -1.1]]), 1.0)
    assert inside.tolist() == [True, True, False, False]


def test_settings_without_a_meaning_are_refused():
    with pytest.raises(ValueError, match=r"detection: 1\.0"):
        RbmcdaParameters(detection=1.0)
    with pytest.raises(ValueError, match="cycle: 0"):
        RbmcdaParameters(cycle=0.0)
