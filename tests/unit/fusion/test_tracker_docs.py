"""docs/trackers.md is tried by following it: its tracker runs, names people, forgets, and goes on where it was."""

import re
from pathlib import Path
from types import ModuleType

import pytest
from fusion_world import World, make_site

from services.fusion.area_view import AreaView
from services.fusion.registry import TRACKERS
from services.fusion.tracker import Chunk, Tracker, TrackerStateError
from shared.messages import Erasure

PAGE = Path(__file__).resolve().parents[3] / "docs" / "trackers.md"


@pytest.fixture(scope="module")
def written() -> ModuleType:
    (code,) = re.findall(r"```python\n(from typing.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    module = ModuleType("nearest")
    exec(code, module.__dict__)
    return module


def test_the_tracker_of_the_page_names_people_and_goes_on_where_it_was(written: ModuleType, tmp_path: Path) -> None:
    site = make_site(tmp_path)
    view = AreaView.of(site, "hall")
    tracker: Tracker = written.NearestTracker(view)
    chunks = World(site, seed=1, seconds=8.0, people=3).chunks()
    frames = [tracker.step(chunk) for chunk in chunks]
    named = {device for frame in frames for device in frame.device if device is not None}
    assert named
    assert all(len(set(known)) == len(known) for frame in frames for known in [[d for d in frame.device if d]])
    again = written.NearestTracker(view)
    again.restore(tracker.state())
    with pytest.raises(TrackerStateError):
        again.restore(b'{"tracker": "nearest"}')
    last = chunks[-1]
    gone = tuple(Erasure(t=last.t_end, device=device) for device in sorted(named))
    after = Chunk(last.index + 1, last.t_end, last.t_end + 0.1, erasures=gone)
    told = tracker.step(after)
    assert told == again.step(after)
    assert told.device == [None] * len(told.track)
    assert tracker.state() == again.state()


def test_every_tracker_stands_in_the_table() -> None:
    table = set(re.findall(r"`([a-z-]+)`", " ".join(re.findall(r"^\| (`.*?) \|", PAGE.read_text(), re.MULTILINE))))
    assert table >= TRACKERS.keys()
