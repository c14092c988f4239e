"""Models as a document: what leaves, what comes in, what is refused and why."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from learning_models import TestLearner, area, lesson, power_of, radio, stride
from sqlalchemy import event, select
from sqlalchemy.orm import Session

from services.learning.activation.bundle import BundleError, Renaming, pack, unpack
from services.learning.activation.content import Contents
from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.rows import Decided
from services.learning.activation.store import ModelStore
from services.learning.activation.tables import ModelRow
from services.learning.commands import Commands
from services.learning.loop import LearningLoop
from shared.learning_command import LearningAnswer
from shared.messages import DetectorSettings, Erasure, Message, RadioModelUpdate, encode
from shared.site import Site, load_site
from shared.site.geometry_digest import geometry_digest

POINTS = [f"ap-{number}" for number in range(1, 7)]
AS_IT_IS = Renaming(as_site=False, areas={}, cameras={})
HOW = Decided(50.0, 50.0, "wins", evidence={"readings": 700.0})


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


@pytest.fixture
def store() -> ModelStore:
    store = ModelStore(in_memory())
    store.activate(radio("hall", -41.0, "hall", POINTS), "radio", "hall", "hall", HOW)
    settings = DetectorSettings(t=0.0, camera="hall-east", version=0, options={"sensitivity": 20.0})
    store.activate(settings, "detector", "hall-east", "hall", HOW)
    store.activate(stride("d-1"), "stride", "d-1", "hall", HOW)
    store.refuse(radio("hall", -60.0, "hall", POINTS), "radio", "hall", "hall", HOW)
    return store


@pytest.fixture
def document(store: ModelStore) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(pack(store.models(), "hall", 60.0, personal=False))
    return found


def refused(document: Any, site: Site, names: Renaming = AS_IT_IS) -> str:
    with pytest.raises(BundleError) as error:
        unpack(json.dumps(document).encode(), site, names)
    return str(error.value)


def test_what_is_live_goes_round_and_people_stay_at_home(store: ModelStore, site: Site) -> None:
    public = unpack(pack(store.models(), "hall", 60.0, personal=False), site, AS_IT_IS)
    assert [(one.kind, one.subject) for one in public] == [("detector", "hall-east"), ("radio", "hall")]
    assert power_of(public[1].model) == -41.0
    assert public[1].evidence == {"readings": 700.0}
    assert public[1].reason == "from hall, version 1 there: wins"
    whole = unpack(pack(store.models(), "hall", 60.0, personal=True), site, AS_IT_IS)
    assert {one.kind for one in whole} == {"detector", "radio", "stride"}


def test_a_second_museum_with_the_same_access_points_says_so_by_name(document: dict[str, Any], site: Site) -> None:
    other = site.model_copy(update={"site": "second"})
    assert "allowed: second, or another site's models taken for this one's (--as-site)" in refused(document, other)
    taken = unpack(json.dumps(document).encode(), other, Renaming(as_site=True, areas={}, cameras={}))
    model = taken[1].model
    assert isinstance(model, RadioModelUpdate)
    assert model.model is not None
    assert model.model.site == "second"


def test_a_camera_of_another_name_is_renamed_and_an_unknown_one_refused(document: dict[str, Any], site: Site) -> None:
    for one in document["models"]:
        if one["kind"] == "detector":
            one["subject"] = one["model"]["camera"] = "door"
    assert "found camera 'door'; allowed in area hall: hall-east (--camera OLD=NEW)" in refused(document, site)
    wrong = Renaming(as_site=False, areas={}, cameras={"door": "attic"})
    assert refused(document, site, wrong) == "cameras.door: found 'attic'; allowed: hall-east"
    names = Renaming(as_site=False, areas={}, cameras={"door": "hall-east"})
    taken = unpack(json.dumps(document).encode(), site, names)
    assert isinstance(taken[0].model, DetectorSettings)
    assert (taken[0].subject, taken[0].model.camera) == ("hall-east", "hall-east")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda d: d.update(format="atrium-models/2"),
            "bundle.format: found 'atrium-models/2'; allowed: atrium-models/1",
        ),
        (lambda d: d.update(models=[]), "bundle.models: found none"),
        (lambda d: d["models"].append(d["models"][0]), "bundle.models[2]: a second detector model of 'hall-east'"),
        (lambda d: d["models"][1].update(area="attic"), "bundle.models[1].area: found 'attic'; allowed: hall"),
        (
            lambda d: d["models"][1].update(subject="x"),
            "bundle.models[1].subject: found 'x'; allowed: that of its model",
        ),
        (lambda d: d["models"][1]["model"].pop("area"), "bundle.models[1].model: RadioModelUpdate"),
        (lambda d: d["models"][1]["model"]["model"].update(access_points=["ap-9"] * 6), "other access points than"),
        (lambda d: d["models"][1]["model"]["model"].update(site="x"), "model.site: found 'x'; allowed: that of the"),
        (lambda d: d["models"][1].update(kind="weather"), "Invalid enum value 'weather'"),
        (
            lambda d: d["models"][0]["model"].update(options={"nonsense": 5}),
            "bundle.models[0].model: options: found 'nonsense'; allowed: learning_rate, sensitivity",
        ),
        (
            lambda d: d["models"][0]["model"].update(options={"learning_rate": -5}),
            "options.learning_rate: found -5; allowed: 1e-06 to 10",
        ),
        (lambda d: d["models"][1]["model"]["model"].update(cell=1e300), "model.cell: found 1e+300; allowed: 0.01 to"),
        (lambda d: d["models"][1]["model"]["model"]["exponent"].__setitem__(2, -3.0), "model.exponent: found -3;"),
        (lambda d: d["models"][1].update(version=10**30), "models[1].version"),
        (lambda d: d["models"][1].update(evidence={"x" * 200: 1.0}), "length <= 128"),
    ],
)
def test_what_does_not_fit_is_refused_by_place_and_value(
    document: dict[str, Any], site: Site, change: Any, words: str
) -> None:
    change(document)
    assert words in refused(document, site)


def carried(kind: str, **model: Any) -> dict[str, Any]:
    subject = model.get("device", model.get("camera"))
    model = {"t": 0.0, "version": 1, **model}
    return {"kind": kind, "subject": subject, "area": "hall", "version": 1, "t": 0.0, "model": model}


def phones(*devices: str, slope: float = 0.3) -> list[dict[str, Any]]:
    lines = {"slope": slope, "offset": 0.1, "scale_variance": 0.01}
    return [carried("stride", device=device, **lines) for device in devices]


@pytest.mark.parametrize(
    ("model", "words"),
    [
        *((phones(device)[0], "stride model: found a subject called") for device in ("d/../*", "*", "d 1")),
        (phones("d-1", slope=-1e9)[0], "slope: found -1e+09; allowed: -5 to 5"),
        (carried("heading", device="d-1", bias=0.1, variance=-1.0), "variance: found -1; allowed: 0 to 100"),
        *(
            (carried("alignment", camera="hall-east", homography=homography), words)
            for homography, words in (
                ([1e300, 0, 0, 0, 1e300, 0, 0, 0, 1], "allowed: nine finite numbers"),
                ([0] * 9, "mirrors or flattens"),
                ([1, 0, 40, 0, 1, 0, 0, 0, 1], "moves the floor the camera sees by 40 m; allowed: at most 10 m"),
                ([9, 0, 0, 0, 9, 0, 0, 0, 1], "stretches the plan by 9 to 9"),
            )
        ),
    ],
)
def test_what_no_model_may_say_is_refused_on_the_way_in_even_if_forced(
    document: dict[str, Any], site: Site, model: dict[str, Any], words: str
) -> None:
    document["models"].append(model)
    assert words in refused(document, site)
    here = Museum(site)
    assert not here.order(do="import", bundle=document, force=True).done
    assert (here.sent, here.store.models()) == ([], [])


def test_what_an_alignment_that_was_learned_says_comes_in(document: dict[str, Any], site: Site) -> None:
    document["models"].append(
        carried(
            "alignment",
            camera="hall-east",
            homography=[1, 0.1, 0.5, -0.1, 1, 2, 0, 0, 1],
            geometry=geometry_digest(site.camera("hall-east").geometry),
        )
    )
    assert [one.kind for one in unpack(json.dumps(document).encode(), site, AS_IT_IS)][2] == "alignment"


def test_what_was_said_of_a_model_does_not_grow_from_museum_to_museum(document: dict[str, Any], site: Site) -> None:
    document["models"][1]["reason"] = "so it is. " * 10_000
    assert len(unpack(json.dumps(document).encode(), site, AS_IT_IS)[1].reason) == 500


class Museum:
    """A loop, its orders, and what it sent."""

    def __init__(self, site: Site, store: ModelStore | None = None) -> None:
        self.sent: list[Message] = []
        self.store = store or ModelStore(in_memory())
        loop = LearningLoop(
            {"hall": area()},
            [lesson(TestLearner())],
            Gate(),
            self.store,
            lambda *_: {"error": "busy"},
            self.sent.append,
        )
        self.loop = loop
        self.commands = Commands(loop, site)

    def order(self, **fields: Any) -> LearningAnswer:
        answer = self.commands.answer(msgspec.json.encode(fields), 100.0)
        return msgspec.json.decode(answer, type=LearningAnswer)


def test_an_import_waits_for_the_gate_unless_it_is_forced(store: ModelStore, site: Site) -> None:
    bundle = Museum(site, store).order(do="export").bundle
    here = Museum(site)
    answer = here.order(do="import", bundle=bundle)
    assert answer.done
    assert "radio of hall" in answer.words.partition("live once they win")[2].partition(";")[0]
    assert answer.words.endswith("live once you say so (`atrium models activate`): detector of hall-east")
    assert here.sent == []
    assert [one.state for one in here.store.models()] == ["imported", "imported"]
    assert here.order(do="import", bundle=bundle, force=True).done
    assert {type(one).__name__ for one in here.sent} == {"DetectorSettings", "RadioModelUpdate"}
    assert {one.state for one in here.store.models()} == {"active"}


def test_an_older_backup_brings_nobody_back_who_withdrew(store: ModelStore, site: Site) -> None:
    here = Museum(site, store)
    backup = json.loads(bytes(here.order(do="export", personal=True).bundle))
    here.loop.take(Erasure(t=90.0, device="d-1"))
    answer = here.order(do="import", bundle=backup, force=True)
    assert answer.done
    assert "1 of phones left out: the phones' owners withdrew consent" in answer.words
    assert {one.kind for one in store.models()} == {"detector", "radio"}
    backup["models"] = [one for one in backup["models"] if one["kind"] == "stride"]
    answer = here.order(do="import", bundle=backup)
    assert (answer.done, answer.field) == (False, "bundle")


def test_a_forced_import_is_all_or_nothing(store: ModelStore, site: Site) -> None:
    bundle = Museum(site, store).order(do="export").bundle
    engine = in_memory()
    here = Museum(site, ModelStore(engine))

    @event.listens_for(engine, "before_cursor_execute")
    def fail(_c: object, _cursor: object, statement: str, values: Any, *_: object) -> None:
        if statement.startswith("INSERT INTO learning_models") and {"radio", "active"} <= set(values):
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        here.order(do="import", bundle=bundle, force=True)
    event.remove(engine, "before_cursor_execute", fail)
    assert (here.sent, here.store.models(), here.store.history()) == ([], [], [])
    assert here.order(do="import", bundle=bundle, force=True).done
    assert [(one.state, one.version) for one in here.store.models()] == [("active", 1)] * 2


@pytest.mark.parametrize("device", ["d/../*", "*"])
def test_a_live_model_that_cannot_be_used_ends_nothing_is_told_and_goes_by_a_roll_back(site: Site, device: str) -> None:
    engine = in_memory()
    before = Museum(site, ModelStore(engine))
    before.store.activate(stride("d-1"), "stride", "d-1", "hall", HOW)
    before.store.activate(radio("hall", -41.0, "hall", POINTS), "radio", "hall", "hall", HOW)
    with Session(engine) as session, session.begin():  # as a program without these checks has left it
        row = session.scalars(select(ModelRow).where(ModelRow.kind == "stride")).one()
        row.subject, row.payload = device, encode(stride(device))
    here = Museum(site, ModelStore(engine, Contents(site)))
    here.loop.begin()
    here.loop.look(100.0)
    assert [type(one) for one in here.sent] == [RadioModelUpdate]
    [told] = here.loop.decisions.untold()
    assert told.startswith("the live stride model of a phone is not in use: stride model: found a subject called")
    assert here.order(do="rollback", kind="stride", subject=device).done
    assert here.loop.decisions.untold() == []
    assert len(here.sent) == 1


def test_a_stored_model_that_cannot_be_used_is_not_made_live_by_hand(store: ModelStore, site: Site) -> None:
    settings = DetectorSettings(t=0.0, camera="hall-east", version=0, options={"learning_rate": -5.0})
    bad = store.refuse(settings, "detector", "hall-east", "hall", HOW)
    here = Museum(site, store)
    answer = here.order(do="activate", kind="detector", subject="hall-east", version=bad.version)
    assert (answer.done, answer.field) == (False, "version")
    assert "options.learning_rate: found -5; allowed: 1e-06 to 10" in answer.words
    assert (here.sent, store.live_version("detector", "hall-east")) == ([], 1)


def test_all_decisions_that_are_kept_can_be_asked_for_page_by_page(site: Site) -> None:
    here = Museum(site)
    for number in range(240):
        which = radio("hall", -41.0, "hall", POINTS) if number % 3 else stride(f"d-{number % 7}")
        kind, subject = ("radio", "hall") if number % 3 else ("stride", f"d-{number % 7}")
        here.store.refuse(which, kind, subject, "hall", Decided(1000.0 + number // 4, 0.0, "loses"))  # type: ignore[arg-type]
    seen: list[float] = []
    asked: dict[str, Any] = {"do": "history", "most": 30, "personal": True}
    while True:
        page = here.order(**asked)
        seen += [one.t for one in page.history]
        assert 30 <= len(page.history) <= 33 or not page.older
        if not page.older:
            break
        asked["before"] = page.history[-1].t
    assert seen == [1000.0 + number // 4 for number in reversed(range(240))]
    assert {one.kind for one in here.order(do="history", most=1000).history} == {"radio"}
    phone = here.order(do="history", kind="stride", subject="d-3", most=1000, personal=True).history
    assert {one.subject for one in phone} == {"d-3"}
    assert here.order(do="history", before=1.0).history == []


def test_an_export_tells_of_what_is_in_it(store: ModelStore, site: Site) -> None:
    here = Museum(site, store)
    assert here.order(do="export").words == "2 models that are live (1 more of people's phones are left out)"
    assert here.order(do="export", personal=True).words == "3 models that are live"


def test_what_is_configured_is_not_rolled_back_again_and_again(store: ModelStore, site: Site) -> None:
    here = Museum(site, store)
    assert here.order(do="rollback", kind="radio", subject="hall").done
    answer = here.order(do="rollback", kind="radio", subject="hall")
    assert (answer.done, answer.field, answer.unknown) == (False, None, False)
    assert answer.words == "radio of 'hall' is as configured already; allowed: none now"
    assert len(here.sent) == 1


@pytest.mark.parametrize("days", [-31.0, 31.0])
def test_a_backup_of_so_long_ago_that_nobody_knows_who_withdrew_brings_no_phone_back(
    store: ModelStore, site: Site, days: float
) -> None:
    there = Museum(site, store)
    backup = json.loads(bytes(there.order(do="export", personal=True).bundle))
    backup["t"] -= 86400.0 * days
    here = Museum(site)
    answer = here.order(do="import", bundle=backup, force=True)
    assert "1 of phones left out: exported over 30 days ago" in answer.words
    assert {one.kind for one in here.store.models()} == {"detector", "radio"}
    backup["models"] = [one for one in backup["models"] if one["kind"] == "stride"]
    answer = here.order(do="import", bundle=backup)
    assert (answer.done, answer.field) == (False, "bundle")
    assert "allowed: of phones" in answer.words
    backup["t"] += 86400.0 * days * 29.0 / 31.0
    assert here.order(do="import", bundle=backup).done


def test_an_import_that_is_refused_stores_nothing(document: dict[str, Any], site: Site) -> None:
    document["models"][1]["area"] = "attic"
    here = Museum(site)
    answer = here.order(do="import", bundle=document)
    assert (answer.done, answer.field) == (False, "areas")
    assert here.store.models() == []
    assert here.store.history() == []


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"do": "rollback"}, "kind", "kind: is missing"),
        ({"do": "rollback", "kind": "radio"}, "subject", "subject: is missing"),
        ({"do": "rollback", "kind": "radio", "subject": "attic"}, "subject", "allowed: hall"),
        ({"do": "activate", "kind": "radio", "subject": "hall"}, "version", "version: is missing"),
        ({"do": "activate", "kind": "radio", "subject": "hall", "version": 7}, "version", "found 7; allowed: 1, 2"),
        ({"do": "activate", "kind": "radio", "subject": "hall", "version": 1}, "version", "is live already"),
        ({"do": "map", "area": "attic"}, "area", "found 'attic'; allowed: hall"),
        ({"do": "dance"}, None, "not understood"),
        ({"do": "list", "colour": 1}, None, "not understood"),
    ],
)
def test_an_order_that_cannot_be_carried_out_names_what_is_allowed(
    store: ModelStore, site: Site, fields: dict[str, Any], field: str | None, words: str
) -> None:
    here = Museum(site, store)
    answer = here.order(**fields)
    assert not answer.done
    assert answer.field == field
    assert words in answer.words
    assert here.sent == []


def test_a_frozen_museum_says_so_and_a_refused_model_can_be_made_live_by_hand(store: ModelStore, site: Site) -> None:
    here = Museum(site, store)
    assert here.order(do="freeze").done
    assert here.order(do="list").words == "4 models, 3 of them live; activation is frozen"
    answer = here.order(do="activate", kind="radio", subject="hall", version=2, by="staff")
    assert answer.done
    assert power_of(here.sent[0]) == -60.0
    assert here.store.history()[0].reason == "activated by hand, untried (staff)"
    back = here.order(do="rollback", kind="radio", subject="hall")
    assert back.version is not None
    assert power_of(here.sent[1]) == -41.0
    assert here.order(do="unfreeze").done
    assert here.order(do="map", area="hall", map="visits").words == "no such map is learned here yet"
