"""How wrong are the numbers a curator reads? People, stays and ways from stored positions, beside the truth."""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from sqlalchemy import Engine, delete

from benchmarks.experiment import Experiment, Figures, Options, in_parallel
from benchmarks.fusion_run import FusionRun, run_fusion
from benchmarks.world_record import Truth
from benchmarks.world_run import load, record_world
from services.history.analytics.heat_map import HeatMapSum, grid_of
from services.history.analytics.visits import Visits, VisitSum, dwell_of, flows_of, lasting
from services.history.database import migrate, open_history
from services.history.entries import Entry
from services.history.reads import Part, parts_of
from services.history.sampling import Sampler
from services.history.store import Store
from services.history.tables import BlockRow
from shared.history_query import AskDwell, AskFlows
from shared.site import FloorPlan

__all__ = ["EXPERIMENT", "compared", "judged", "main", "stored_visits", "true_visits"]

WORLDS = {"museum": 1200.0}
"""Seconds of worlds with visitors and a camera, at their train seeds."""
CELL = 0.5
ACROSS = 3
"""Places along each side of a floor."""
TRUTH_STEP = 5
"""Of the truth's times every so manieth: one a second, as history keeps."""
BATCH = 200
"""Entries brought in at once."""
DWELL = AskDwell(since=0.0, until=1.0)
FLOWS = AskFlows(since=0.0, until=1.0)

Polygons = list[NDArray[np.float64]]


def places_of(plan: FloorPlan) -> Polygons:
    """Return rectangles that tile a floor's bounds."""
    left, bottom, right, top = plan.outline.bounds
    x, y = np.linspace(left, right, ACROSS + 1), np.linspace(bottom, top, ACROSS + 1)
    return [
        np.array([(a, c), (b, c), (b, d), (a, d)])
        for (a, b), (c, d) in itertools.product(itertools.pairwise(x), itertools.pairwise(y))
    ]


def stored_visits(engine: Engine, floor: str, places: Polygons, since: float, until: float) -> Visits:
    """Return the stays that history finds in what it stored."""
    return _visits(parts_of(engine, "track", since, until, floor), places)


def _visits(parts: Iterable[Part], places: Polygons) -> Visits:
    total, known = VisitSum(places, DWELL.away), np.empty(0, bool)
    for part in parts:
        total.add(range(len(places)), part.person, part.t, part.x, part.y, part.seconds)
        known = part.known
    return lasting(total.visits(known), DWELL.shortest)


def true_visits(truth: Truth, places: Polygons) -> Visits:
    """Return everybody's stays as they were, by the same rules."""
    return _visits([_part(truth)], places)


def compared(found: Visits, really: Visits, places: int) -> dict[str, float]:
    """Return by how much stays are wrong, over all places.

    ``people``: people counted per person really there; ``visits`` likewise; ``people_error``: absolute differences
    of people, per person really there; ``dwell_p50``: the mean over places of the difference of medians, s;
    ``dwell_p50_true``: of the medians; ``flows``: ways counted per way; ``flows_error``: absolute differences, per way.
    """
    pairs = [(dwell_of(found, place), dwell_of(really, place)) for place in range(places)]
    both = [(a, b) for a, b in pairs if a.visits and b.visits]
    people = sum(b.people for _, b in pairs)
    ways, true_ways = (flows_of(visits, places, FLOWS.within)[0] for visits in (found, really))
    return {
        "people": sum(a.people for a, _ in pairs) / people,
        "people_error": sum(abs(a.people - b.people) for a, b in pairs) / people,
        "visits": len(found.place) / len(really.place),
        "dwell_p50": float(np.mean([a.median - b.median for a, b in both])),
        "dwell_p50_true": float(np.mean([b.median for _, b in both])),
        "flows": float(ways.sum() / true_ways.sum()),
        "flows_error": float(np.abs(ways - true_ways).sum() / true_ways.sum()),
    }


def score(scenario: str, seconds: float) -> dict[str, float]:
    """Return the figures of one world, of its first area with a camera."""
    world, site = load(scenario)
    area = site.area(site.cameras[0].area)
    record = record_world(world, site, world.seeds.train, seconds=seconds)[area.id]
    fusion = run_fusion(record)
    return judged(record.truth, fusion, area.id, area.floor, places_of(site.floor(area.floor).plan()))


def judged(truth: Truth, fusion: FusionRun, area: str, floor: str, places: Polygons) -> dict[str, float]:
    """Return how wrong what is stored of a run is: every track somebody, and as history joins them."""
    since, until = float(truth.t[0]), float(truth.t[-1]) + 60.0
    really = true_visits(truth, places)
    figures: dict[str, float] = {"people_true": float(len(np.unique(really.person)))}
    with tempfile.TemporaryDirectory(prefix="atrium-visits-") as folder:
        url = f"sqlite:///{Path(folder) / 'history.db'}"
        migrate(url)
        engine = open_history(url)
        store = Store(engine)
        for number, batch in enumerate(_batches(Sampler(1.0, {area: floor}), fusion)):
            store.apply(f"{number}", batch, [])
        persons = stored_visits(engine, floor, places, since, until)
        with engine.begin() as connection:
            connection.execute(delete(BlockRow).where(BlockRow.kind == "device"))
        tracks = stored_visits(engine, floor, places, since, until)
        in_cells = people_in_cells(parts_of(engine, "track", since, until, floor), places)
        engine.dispose()
    figures |= {f"tracks_{name}": value for name, value in compared(tracks, really, len(places)).items()}
    figures |= {f"persons_{name}": value for name, value in compared(persons, really, len(places)).items()}
    without = [visits.where(~visits.known) for visits in (persons, really)]
    told, true = (sum(dwell_of(visits, place).people for place in range(len(places))) for visits in without)
    figures["without_phone"] = told / true if true else float("nan")
    figures["cell_people"] = in_cells / people_in_cells([_part(truth)], places)
    return figures


def people_in_cells(parts: Iterable[Part], places: Polygons) -> int:
    """Return how many people were in cells of half a metre, each once in each cell."""
    corners = np.concatenate(places)
    origin, rows, columns = grid_of((*corners.min(axis=0), *corners.max(axis=0)), CELL)
    total, people = HeatMapSum(origin, CELL, rows, columns), 0
    for part in parts:
        total.add(part.person, part.x, part.y, part.seconds)
        people = max(people, int(part.person.max(initial=-1)) + 1)
    return int(total.told(np.ones(people, bool), 1)[1].sum())


def _part(truth: Truth) -> Part:
    """Return where everybody really was, once a second."""
    t, where = truth.t[::TRUTH_STEP], truth.position[::TRUTH_STEP]
    row, person = np.nonzero(np.isfinite(where[..., 0]))
    x, y = where[row, person].T.astype(float)
    known = np.array([device is not None for device in truth.device])
    seconds = np.full(len(row), float(t[1] - t[0]))
    return Part(person.astype(np.int64), known, np.zeros(len(row), np.int64), t[row], x, y, seconds, [""])


def _batches(sampler: Sampler, fusion: FusionRun) -> Iterator[list[Entry]]:
    """Yield what history keeps of a run, some seconds at a time."""
    revisions = {revision.chunk: revision for revision in fusion.revisions}
    batch: list[Entry] = []
    for frame in fusion.frames:
        batch += sampler.tracks(frame)
        revision = revisions.get(frame.chunk)
        replaced = None if revision is None else sampler.revision(revision)
        batch += [] if replaced is None else [replaced]
        if len(batch) >= BATCH:
            yield batch
            batch = []
    yield batch


def run(options: Options, progress: Progress) -> Figures:
    """Return ``museum_tracks_people`` …."""
    cells = [(name, options.more.seconds or seconds) for name, seconds in WORLDS.items()]
    scores = in_parallel(score, cells, options.jobs, progress, "worlds")
    return {
        f"{scenario.replace('-', '_')}_{name}": value
        for (scenario, _), figures in zip(cells, scores, strict=True)
        for name, value in figures.items()
    }


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, help=f"of each world; default {WORLDS}")


EXPERIMENT = Experiment(
    name="visits",
    question="How wrong are the people, stays and ways that history tells?",
    kind="twin",
    scenario="training worlds",
    seed=0,
    run=run,
    seeds=False,
    arguments=_arguments,
    made="""Worlds at their train seeds through camera model, gateway and fusion into a database; the floor is cut into
nine places. Beside the truth by the same rules (a stay lasts 5 s, ends after 10 s away; ways of up to ten
minutes): `tracks`, every track somebody, and `persons`, as history tells it: tracks that carried the same
phone joined. `people`, `visits`, `flows`: counted per one there really was, over all places; `…_error`:
absolute differences per one there was; `dwell_p50`: by how many seconds a place's median stay is too long, in
the mean over places. `without_phone`: those counted at a place without a known phone, per person there
without one, and `cell_people`: all those counted in cells of half a metre, per person in them: what the rule
of five people has to allow for.""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
