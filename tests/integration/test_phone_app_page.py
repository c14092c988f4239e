"""docs/phone-app.md cannot rot: its commands are run in their order, and answer with the fields that it shows."""

import json
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT
from gateway_process import Listener, Running, running_gateway
from trial_walking import trial_walk
from waiting import wait_until

from shared.messages import Alert, TrackFrame

PAGE = (ROOT / "docs" / "phone-app.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"```(sh|json)\n(.*?)```", re.S)
END = "end of this block:"


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    key = {"ATRIUM_ENROLMENT_KEY": "demo-enrolment-key"}
    with running_gateway(tmp_path_factory.mktemp("gateway"), **key) as running:
        yield running


class Shell:
    """Somebody who types what the page says, block after block."""

    def __init__(self, folder: Path) -> None:
        self._process = subprocess.Popen(
            ["bash"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def type(self, block: str) -> str:
        """Run a block; return what it printed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f'{block}\necho; echo "{END} $?"\n')
        self._process.stdin.flush()
        lines = []
        for line in self._process.stdout:
            if line.startswith(END):
                assert line.split()[-1] == "0", f"{block}\n{''.join(lines)}"
                return "".join(lines).strip()
            lines.append(line)
        raise AssertionError(f"the shell ended:\n{''.join(lines)}")

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


def locate(listener: Listener, device: str) -> None:
    """Let a camera's track carry the device, and the device enter a zone."""
    frame = {
        "track": [1], "floor": ["ground"], "x": [8.0], "y": [1.5], "covariance": [(0.04, 0.0, 0.05)], "vx": [0.0],
        "vy": [0.0], "state": ["confirmed"], "device": [device], "probability": [0.93], "runner_up": [None],
        "runner_up_probability": [0.0], "former": [[]], "sources": [[]], "quality": [1.0],
    }  # fmt: skip
    tracks = TrackFrame(t=time.time(), area="hall", chunk=1, tracker="test", **frame)  # type: ignore[arg-type]
    listener.bus.publisher(listener.keys.tracks("hall"), TrackFrame).publish(tracks)
    alert = Alert(
        id="1", t=1.0, zone="entrance", kind="enter", area="hall", track=1, floor="ground", x=8.0, y=1.5, device=device
    )
    listener.bus.publisher(listener.keys.alert("entrance"), Alert, cached=True).publish(alert)


def fields(value: Any) -> Any:
    """The form of an answer: its fields, without their values; of a list each form once; reasons are not fixed."""
    if isinstance(value, dict):
        return {name: fields(part) for name, part in value.items() if name != "ignored"}
    if isinstance(value, list):
        forms = [fields(part) for part in value if isinstance(part, dict)]
        return [form for number, form in enumerate(forms) if form not in forms[:number]]
    return None


def test_every_command_of_the_page_works_and_answers_as_the_page_says(gateway: Running, tmp_path: Path) -> None:
    slow, quick = trial_walk(1, 1.1, 9.0), trial_walk(1, 1.6, 9.0)
    (tmp_path / "walks.json").write_text(json.dumps({"walks": [slow.body(steps=slow.steps), quick.body()]}))
    shell, listener = Shell(tmp_path), Listener(gateway.endpoint)
    answer, answered = "", 0
    try:
        for kind, text in BLOCK.findall(PAGE):
            if kind == "sh":
                command = text.replace("http://127.0.0.1:8080", str(gateway.http.base_url))
                if "/position" in command:
                    enrolled = json.loads((tmp_path / "enrolled.json").read_text())
                    headers = {"Authorization": f"Bearer {enrolled['token']}"}

                    def seen(enrolled: dict[str, str] = enrolled, headers: dict[str, str] = headers) -> bool:
                        locate(listener, enrolled["device"])
                        position = gateway.http.get(enrolled["position"], headers=headers)
                        alerts = gateway.http.get(enrolled["alerts"], headers=headers).json()["alerts"]
                        return position.status_code == 200 and len(alerts) == 1

                    wait_until(seen, 10, "the phone to be seen")
                answer = shell.type(command)
            elif answer:
                assert fields(json.loads(answer)) == fields(json.loads(text)), f"{answer}\nbut the page shows\n{text}"
                answer, answered = "", answered + 1
    finally:
        shell.close()
        listener.bus.close()
    assert answered >= 8
    gone = gateway.http.get(enrolled["position"], headers=headers)
    assert gone.status_code == 401  # the last command withdrew the consent


def test_every_path_and_setting_of_the_page_exists(gateway: Running) -> None:
    document = gateway.http.get("/openapi.json").json()
    known = {re.sub(r"\{\w+\}", "*", path) for path in document["paths"]} | {"/v1/devices/*/stream"}
    named = re.findall(r"/v1/[\w{}$./-]+", re.sub(r"/d-\w+", "/{device}", PAGE))
    for path in named:
        plain = re.sub(r"\$\w+|\{\w+\}", "*", path.rstrip("."))
        plain = re.sub(r"/v1/schema/[\w-]+\.json", "/v1/schema/*.json", plain)
        assert plain in known, path
    settings = (ROOT / "services" / "gateway" / "settings.py").read_text(encoding="utf-8")
    for setting in set(re.findall(r"ATRIUM_(\w+)", PAGE)):
        assert f"{setting.lower()}:" in settings, setting


def test_the_examples_for_apps_name_the_fields_of_a_batch() -> None:
    for language in ("kotlin", "swift", "dart"):
        block = re.search(rf"```{language}\n(.*?)```", PAGE, re.S)
        assert block is not None, language
        for name in (
            "enrolment_key",
            "consent",
            "batches",
            "sent",
            "seq",
            "imu",
            "echo",
            "replied",
            "arrived",
            "t",
            "mz",
        ):
            assert re.search(rf"""["']{name}["']""", block[1]), (language, name)
        assert max(map(len, block[1].splitlines())) < 140
