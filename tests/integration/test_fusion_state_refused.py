"""A saved state that does not fit: fusion says why, starts anew, and its own state takes the file's place."""

import json
import threading
from pathlib import Path

import pytest
from fusion_world import SITE, frame
from structlog.testing import capture_logs
from waiting import wait_until

from services.fusion.service import FusionService
from services.fusion.settings import FusionSettings
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import DetectionFrame
from shared.runner import Health
from shared.site import load_site

DEADLINE = 20.0
STATE = {"chunk": 5, "tracker": "evidence", "seed": 0, "radio": "", "state": {}}
REFUSED = {
    "another tracker": (json.dumps({**STATE, "tracker": "rbmcda"}), "a state of tracker 'rbmcda', expected 'evidence'"),
    "another radio model": (
        json.dumps({**STATE, "radio": "0" * 64}),
        "a state of another radio model: the site file's access points or the trained model are others now",
    ),
    "nothing of the tracker's": (json.dumps(STATE), "not a state of tracker 'evidence'"),
    "half a file": (json.dumps(STATE)[:30], "truncated"),
}


@pytest.mark.parametrize(("saved", "reason"), REFUSED.values(), ids=list(REFUSED))
def test_a_state_that_does_not_fit_is_refused_in_plain_words_and_replaced(
    saved: str, reason: str, zenoh_router: str, tmp_path: Path
) -> None:
    site_file, file = tmp_path / "site.yaml", tmp_path / "fusion-hall.json"
    site_file.write_text(SITE)
    file.write_text(saved)
    settings = FusionSettings.model_validate(
        {"site_file": site_file, "area": "hall", "state_folder": tmp_path, "state_every": 0.1}
    )
    with Bus([zenoh_router]) as bus, Bus([zenoh_router]) as own, capture_logs() as lines:
        service = FusionService(settings, load_site(site_file), own, Health())
        running = threading.Thread(target=service.run)
        running.start()
        try:
            assert service.health.ready.wait(DEADLINE)
            (told,) = [line["reason"] for line in lines if line["event"] == "starting without the saved state"]
            assert reason in told
            assert file.read_text() == saved  # until there is anything to save
            assert json.loads(service.answer_state())["chunk"] == -1
            cameras = [bus.publisher(Keys("test-hall").detections(name), DetectionFrame) for name in ("west", "east")]
            number = 0

            def replaced() -> bool:
                nonlocal number
                number += 1
                for name, publisher in zip(("west", "east"), cameras, strict=True):
                    publisher.publish(frame(1e9 + number / 10, [(6.0, 7.0)], name, number))
                return file.read_text() != saved

            wait_until(replaced, DEADLINE, "a state of its own")
            assert json.loads(file.read_text())["tracker"] == "evidence"
            assert sorted(tmp_path.glob("*.json")) == [file]
        finally:
            service.stop()
            running.join(DEADLINE)
