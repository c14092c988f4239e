"""Setting a site up over HTTP: a real api process, a camera's still desk on a real bus, files on a real disk."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
import schemathesis
import yaml
from conftest import unused_port
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode
from service_process import process
from waiting import wait_until

from services.camera.still_desk import StillDesk
from shared.bus import Bus, Inbox, router
from shared.keys import Keys
from shared.setup_told import SetupTold
from shared.site import CameraGeometry, load_site
from shared.site.setup_change import change_setup
from shared.site.setup_file import CameraSetup, SetUp, setup_path
from shared.site.site_file import Lens

KEYS = [
    {"name": "installer", "key": "the-key-of-the-installer", "scopes": ["site", "stills", "setup", "audit"]},
    {"name": "reader", "key": "the-key-of-a-reader", "scopes": ["site", "positions"]},
    {"name": "plain", "key": "the-key-in-plain-text"},
]
SIZE = (640, 480)
TRUE = CameraGeometry.from_pose(SIZE, (10.0, -4.0, 6.0), (10.0, 6.0, 0.0), 1.2)
PIXELS = np.array([[60, 460], [590, 440], [320, 300], [150, 250], [500, 240], [330, 450], [80, 330], [560, 330]], float)
OPEN, SHUT = "hall-east", "hall-west"


@dataclass
class System:
    http: httpx.Client
    folder: Path
    site_file: Path
    desk: StillDesk
    clock: list[float]
    inbox: Inbox

    def told(self) -> SetupTold:
        """The set-up heard last on the bus."""
        (*_, last) = self.inbox.receive(10.0)
        assert isinstance(last.message, SetupTold)
        return last.message

    def get(self, path: str, status: int = 200, key: str = "the-key-of-the-installer") -> Any:
        answer = self.http.get(path, headers={"X-API-Key": key})
        assert answer.status_code == status, answer.text
        return answer.json() if "json" in answer.headers["content-type"] else answer

    def drawn(self, camera: str) -> Any:
        """A camera as the map shows it."""
        return next(one for one in self.get("/site")["cameras"] if one["id"] == camera)

    def post(self, path: str, body: object, status: int = 200, key: str = "the-key-of-the-installer") -> Any:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        answer = self.http.post(path, content=content, headers={"X-API-Key": key})
        assert answer.status_code == status, answer.text
        return answer.json()


@pytest.fixture(scope="module")
def system(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp("api-setup")
    site = yaml.safe_load((project / "deploy/sites/hall/site.yaml").read_text(encoding="utf-8"))
    camera = site["cameras"][0] | {"id": OPEN}
    site["cameras"] = [camera, {**camera, "id": SHUT}]
    site_file = folder / "site.yaml"
    site_file.write_text(yaml.safe_dump(site))
    (folder / "filed.yaml").write_text(yaml.safe_dump(site))  # nothing is ever set up beside this one
    endpoint, port = f"tcp/127.0.0.1:{unused_port()}", unused_port()
    session = router(endpoint)
    clock = [100.0]
    desk = StillDesk(OPEN, True, 15.0, clock=lambda: clock[0])
    keys = Keys(site["site"])
    settings = {"ATRIUM_API_PORT": str(port), "ATRIUM_API_KEYS": json.dumps(KEYS)}
    with (
        Bus([endpoint]) as bus,
        process("services.api", folder, endpoint, site_file, **settings),
        httpx.Client(base_url=f"http://127.0.0.1:{port}/v1", timeout=30.0) as http,
    ):
        bus.answer_questions(keys.still(OPEN), desk.take)
        inbox = bus.inbox()
        inbox.subscribe(keys.setup(), SetupTold, cached=True)
        yield System(http, folder, site_file, desk, clock, inbox)
    session.close()  # type: ignore[no-untyped-call]


def pairs(count: int = 8) -> list[dict[str, list[float]]]:
    places = TRUE.to_ground(PIXELS)
    return [
        {"pixel": pixel.tolist(), "place": place.round(4).tolist()}
        for pixel, place in zip(PIXELS[:count], places[:count], strict=True)
    ]


def test_a_still_is_given_to_who_may_have_it_after_it_was_opened_and_everything_is_noted(system: System) -> None:
    path = f"/cameras/{OPEN}/still"
    picture = np.full((480, 640, 3), 90, np.uint8)
    system.desk.offer(picture, 1767225600.5)
    assert "may not see pictures" in system.get(path, 403, "the-key-of-a-reader")["detail"]
    assert system.get(path, 403, "the-key-in-plain-text")["allowed"] == "a key with the scope stills, too"
    assert system.get(path, 409)["title"] == "Stills are not open"
    assert "15 minutes" in system.post(path, {})["words"]
    given = system.get(path)
    assert given.headers["content-type"] == "image/jpeg"
    assert given.headers["cache-control"] == "no-store"
    assert float(given.headers["x-atrium-taken"]) == 1767225600.5
    assert cv2.imdecode(np.frombuffer(given.content, np.uint8), cv2.IMREAD_COLOR).shape == picture.shape
    answer = system.http.get(path, headers={"X-API-Key": "the-key-of-the-installer"})
    assert (answer.status_code, answer.headers["retry-after"]) == (429, "1")
    system.clock[0] += 1.0
    assert "no checkerboard" in system.get(f"/cameras/{OPEN}/board?columns=9&rows=6", 404)["detail"]
    assert system.get(f"/cameras/{OPEN}/board?columns=1&rows=6", 422)["field"] == "columns"
    assert "does not run" in system.get(f"/cameras/{SHUT}/still", 503)["detail"]
    assert system.get("/cameras/garden/still", 404)["allowed"] == f"{OPEN}, {SHUT}"
    noted = {
        (one["who"], one["action"], one["status"])
        for one in system.get("/audit")["entries"]
        if "still" in one["subject"]
    }
    opened, seen = ("installer", "POST", 200), ("installer", "GET", 200)
    assert noted == {opened, seen, ("reader", "GET", 403), ("plain", "GET", 403)}


def test_a_trial_tells_residuals_grid_and_the_wrong_click_and_stores_nothing(system: System) -> None:
    order: dict[str, Any] = {"image_size": SIZE, "pairs": pairs()}
    assert system.post(f"/cameras/{OPEN}/calibration/try", order, 403, key="the-key-of-a-reader")["found"]
    told = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert told["median_metres"] < 0.01
    assert told["median_alone_metres"] < 0.01
    assert told["position"] == pytest.approx([10, -4, 6], abs=0.02)
    assert told["step"] == 1.0
    assert len(told["grid"]) > 10
    order["pairs"][5]["pixel"] = [400.0, 300.0]
    told = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert [pair["used"] for pair in told["pairs"]] == [row != 5 for row in range(8)]
    assert told["words"][0].startswith("Pair 6 is taken for a wrong click and left out")
    order["pairs"] = pairs(4)
    corners = TRUE.to_image(np.array([[8, 2, 0], [12, 2, 0], [12, 5, 0], [8, 5, 0]], float)).tolist()
    order["rectangles"] = [{"pixels": corners, "corner": [8, 2], "width": 4, "depth": 3}]
    told = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert len(told["pairs"]) == 8
    assert told["median_metres"] < 0.01
    assert list(system.folder.glob("*.setup*")) == []


def test_a_checkerboard_is_taken_with_a_few_of_its_corners(system: System) -> None:
    places = np.array([[9 + 0.3 * column, 4 + 0.3 * row, 0] for row in range(5) for column in range(7)])
    board = {"pixels": TRUE.to_image(places).tolist(), "columns": 7, "rows": 5, "square": 0.3, "corner": [9, 4]}
    order = {"image_size": SIZE, "boards": [board]}
    told = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert len(told["pairs"]) == 16
    assert told["position"] == pytest.approx([10, -4, 6], abs=0.05)
    order["boards"] = [{**board, "rows": 6}]  # type: ignore[list-item]
    assert (
        "35 corners; allowed: columns x rows, 42"
        in system.post(f"/cameras/{OPEN}/calibration/try", order, 422)["detail"]
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pairs": pairs(3)}, "3 pairs: at least 4 are needed"),
        (
            {"pairs": [{**pair, "place": [index, index]} for index, pair in enumerate(pairs())]},
            "on one line on the plan",
        ),
        ({"pairs": [*pairs(4), {"pixel": [700, 10], "place": [1, 1]}]}, "pair 5: (700, 10) lies outside the 640 x 480"),
        ({"pairs": [{"pixel": [1], "place": [1, 1]}]}, "pairs[0].pixel"),
        ({"pairs": "<script>"}, "pairs: Expected `array`"),
        ({"image_size": [0, 480]}, "image_size[0]"),
        ({"colour": "red"}, "a field that means nothing here"),
        ({"pairs": [{"pixel": [1e300, 5], "place": [1, 1]}]}, "<= 100000"),
    ],
)
def test_what_cannot_be_tried_is_told_in_plain_words(system: System, change: dict[str, Any], words: str) -> None:
    order = {"image_size": SIZE, "pairs": pairs(), **change}
    assert words in system.post(f"/cameras/{OPEN}/calibration/try", order, 422)["detail"]


def test_bodies_that_are_none_are_refused(system: System) -> None:
    path = f"/cameras/{OPEN}/calibration/try"
    assert system.post(path, b"\xff{", 422)["field"] == "body"
    assert system.post(path, b" " * (1 << 20) + b"x", 413)["status"] == 413


def test_what_is_saved_is_what_the_next_start_reads(system: System) -> None:
    path = f"/cameras/{SHUT}/calibration"
    assert system.get(path)["saved"] is None
    order: dict[str, Any] = {"image_size": SIZE, "pairs": pairs(), "area_of_interest": [[0, 479], [0, 100], [639, 100]]}
    order["pairs"][5]["pixel"] = [400.0, 300.0]
    assert "change how the site is set up" in system.post(path, order, 403, "the-key-in-plain-text")["detail"]
    crossing = {**order, "area_of_interest": [[0, 0], [100, 100], [100, 0], [0, 100]]}
    assert "cross" in system.post(path, crossing, 422)["detail"]
    outside = {**order, "area_of_interest": [[0, 0], [900, 100], [100, 0]]}
    assert "lies outside the 640 x 480 picture" in system.post(path, outside, 422)["detail"]
    assert list(system.folder.glob("*.setup*")) == [], "nothing is half stored"
    told = system.post(path, order)
    assert told["words"].startswith(f"Saved. No process of camera {SHUT} is heard")
    heard = system.told()
    while heard.version == 0:  # as it was at the start of the api
        heard = system.told()
    assert heard.version == told["version"] == 1
    assert list(SetUp.model_validate_json(heard.setup).cameras) == [SHUT]
    assert np.allclose(system.drawn(SHUT)["position"], TRUE.position, atol=0.02), "the map follows without a start"
    saved = load_site(system.site_file).camera(SHUT)
    assert np.allclose(saved.geometry.build().position, TRUE.position, atol=0.02)
    assert len(saved.geometry.image) == 7, "the wrong click is left out"  # type: ignore[union-attr]
    assert saved.area_of_interest == [(0, 479), (0, 100), (639, 100)]
    view = system.get(path)
    assert (view["pending"], view["by"], view["kind"], len(view["pairs"])) == (True, "installer", "points", 7)
    system.post(path, {**order, "area_of_interest": None})
    assert load_site(system.site_file).camera(SHUT).area_of_interest is None
    assert (system.folder / "site.setup.1.yaml").is_file()
    # Taken away by hand: the site file counts again, also in what runs.
    filed = load_site(system.site_file.with_name("filed.yaml")).camera(SHUT).geometry.build().position
    setup_path(system.site_file).unlink()
    wait_until(lambda: np.allclose(system.drawn(SHUT)["position"], filed, atol=0.01), 10, "the camera as filed")


def test_a_lens_that_was_calibrated_is_used_and_saved_with_the_pairs(system: System) -> None:
    lens = {"image_size": [320, 240], "focal": [240, 240], "centre": [160, 120], "k1": -0.2, "k2": 0.04}
    bent = Lens.model_validate(lens).model(SIZE)
    camera = CameraGeometry(SIZE, bent.focal, bent.centre, TRUE.rotation, TRUE.translation, radial=bent.radial)
    places = camera.to_ground(PIXELS)
    order = {
        "image_size": SIZE,
        "pairs": [{"pixel": u.tolist(), "place": x.tolist()} for u, x in zip(PIXELS, places, strict=True)],
    }
    straight = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert not straight["lens"]
    entry = CameraSetup.model_validate({"lens": lens})
    change_setup(system.site_file, lambda now: now.model_copy(update={"cameras": {**now.cameras, OPEN: entry}}))
    told = system.post(f"/cameras/{OPEN}/calibration/try", order)
    assert told["lens"]
    assert told["median_metres"] < 0.001
    assert told["median_metres"] < 0.1 * straight["median_metres"]
    assert not system.post(f"/cameras/{OPEN}/calibration/try", {**order, "use_lens": False})["lens"]
    system.post(f"/cameras/{OPEN}/calibration", order)
    saved = load_site(system.site_file).camera(OPEN).geometry.build()
    assert saved.radial == (-0.2, 0.04)
    assert np.allclose(saved.to_ground(PIXELS), places, atol=1e-3)
    square = {**order, "image_size": [640, 640]}
    assert "the proportions differ" in system.post(f"/cameras/{OPEN}/calibration/try", square, 422)["detail"]


def test_access_points_are_placed_and_put_back(system: System) -> None:
    before = {point["id"]: point for point in system.get("/access-points")["access_points"]}
    assert before["ap-1"]["saved"] is None
    system.post("/access-points", {"positions": {"ap-1": [1.5, 2.5, 2.2]}})
    assert load_site(system.site_file).access_points[0].position == (1.5, 2.5, 2.2)
    assert system.get("/access-points")["access_points"][0]["position"] == [1.5, 2.5, 2.2]
    system.post("/access-points", {"positions": {"ap-1": None}})
    assert system.get("/access-points")["access_points"][0] == before["ap-1"]
    assert system.post("/access-points", {"positions": {"'; drop": [1, 2, 3]}}, 404)["title"] == "Unknown access point"
    assert system.post("/access-points", {"positions": {}}, 422)["field"] == "positions"
    assert system.post("/access-points", {"positions": {"ap-1": [1, 2, 3]}}, 403, "the-key-of-a-reader")


def test_nothing_generated_from_the_page_of_the_set_up_breaks_it(system: System) -> None:
    system.desk.offer(np.full((480, 640, 3), 90, np.uint8), 1767225600.5)
    page = schemathesis.openapi.from_dict(system.http.get("../openapi.json").json())
    tried = set()
    for result in page.get_all_operations():
        operation = result.ok()
        if "set-up" not in operation.tags:
            continue
        tried.add((operation.method, operation.path))
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            try:
                cases = operation.as_strategy(generation_mode=mode)

                @settings(max_examples=8, deadline=None, database=None, suppress_health_check=list(HealthCheck))
                @given(cases, st.sampled_from([OPEN, SHUT, None]))
                def send(case: schemathesis.Case, camera: str | None) -> None:
                    if camera is not None and "camera" in case.path_parameters:
                        case.path_parameters["camera"] = camera
                    address = str(system.http.base_url).removesuffix("/v1/")
                    answer = case.call(base_url=address, headers={"X-API-Key": "the-key-of-the-installer"})
                    # Nobody answers for this camera, and that is what is said.
                    silent = answer.status_code == 503 and "does not run or answer" in answer.json()["detail"]
                    assert answer.status_code < 500 or silent, answer.text
                    if answer.status_code >= 400:
                        assert answer.json()["status"] == answer.status_code

                send()
            except Unsatisfiable:
                continue  # what has no inputs has no wrong ones
    assert len(tried) == 8
