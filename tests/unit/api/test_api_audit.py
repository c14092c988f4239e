"""Nobody is looked up unseen, whatever the question looks like, and nobody can use up the log for others."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_app import Api, api
from test_api_accounts import PASSWORD, bearer, issue, sign_in

from services.api.admin.audit_log import AuditLog, Deed
from services.api.admin.passwords import hash_password
from services.api.problems import ProblemError
from services.api.pseudonyms import Pseudonyms


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    monkeypatch.setattr("services.api.admin.passwords.LOG2_N", 4)
    monkeypatch.setattr("services.api.admin.accounts.NOBODY", hash_password("whoever it is"))
    with api(tmp_path) as made:
        made.people(*((f"phone-{n}", 2.0 + n, 7.0) for n in range(7)))
        yield made


def noted(here: Api, action: str = "GET") -> list[tuple[str, str, int, int]]:
    """Who, subject, status and times, newest first."""
    told = here.client.get(f"/v1/audit?action={action}").json()["entries"]
    return [(one["who"].split(" (")[0], one["subject"], one["status"], one["times"]) for one in told]


@pytest.mark.parametrize(
    ("path", "status", "subject"),
    [
        ("/v1/alerts?%64evice=phone-3", 200, "/v1/alerts?device=phone-3"),
        ("/v1/positions?limit=1&cursor=phone-2", 200, "/v1/positions?device=phone-3"),
        ("/v1/devices?limit=1&cursor=phone-2", 200, "/v1/devices?device=phone-3"),
        ("/v1/tracks?near=5,7,0.3", 200, "/v1/tracks?device=phone-3"),
        ("/v1/positions/phone-3", 200, "/v1/positions/phone-3"),
        ("/v1/positions/%70hone-3", 200, "/v1/positions/phone-3"),
        ("/v1/positions/phone-99", 404, "/v1/positions/phone-99"),
        ("/v1/positions/phone-3/exhibits", 200, "/v1/positions/phone-3/exhibits"),
        ("/v1/positions", 200, "/v1/positions"),
        ("/v1/tracks?area=hall", 200, "/v1/tracks"),
        ("/v1/devices?limit=6", 200, "/v1/devices"),
        ("/v1/erasures", 200, "/v1/erasures"),
    ],
)
def test_a_look_up_is_written_down_however_it_is_asked(here: Api, path: str, status: int, subject: str) -> None:
    assert here.client.get(path).status_code == status
    assert noted(here) == [("demo", subject, status, 1)]


def test_of_two_devices_in_one_look_up_none_is_told(here: Api) -> None:
    told = here.client.get("/v1/alerts?device=nobody&device=phone-3")
    assert (told.status_code, told.json()["field"]) == (422, "device")
    assert "phone-3" not in told.text


def test_what_looks_like_a_look_up_and_is_none_is_not_written_down(here: Api) -> None:
    slash = here.client.get("/v1/positions/phone-3/", headers={"Host": "evil.example"}, follow_redirects=False)
    assert (slash.status_code, "location" in slash.headers) == (404, False)
    for path in ("/v1/site?device=phone-3", "/v1/zones?device=x", "/v1/positions/a%20b", "/v1/cameras"):
        here.client.get(path)
    assert noted(here) == []


def test_reads_of_everybody_are_one_row_of_an_hour_for_each_holder(here: Api) -> None:
    first = here.client.get("/v1/positions")
    for _ in range(3):
        here.client.get("/v1/positions")
    here.client.get("/v1/positions", headers={"If-None-Match": first.headers["ETag"]})
    guide = bearer(issue(here)["key"])
    here.client.get("/v1/positions", headers=guide)
    assert {row[:2]: row[3] for row in noted(here) if row[2] == 200} == {
        ("demo", "/v1/positions"): 4,
        ("guide-app", "/v1/positions"): 1,
    }


def test_one_holder_cannot_use_up_the_log_for_others(here: Api) -> None:
    log = AuditLog(here.admin.engine, days=1.0, pseudonyms=Pseudonyms())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("services.api.admin.audit_log.MOST_OF_ONE", 2)
        for number in range(2):
            log.look_up(Deed("a", "GET", f"/v1/positions/x{number}", 404), "key a")
        with pytest.raises(ProblemError) as caught:
            log.look_up(Deed("a", "GET", "/v1/positions/x2", 404), "key a")
        assert (caught.value.problem.status, caught.value.headers) == (429, {"Retry-After": "60"})
        log.look_up(Deed("b", "GET", "/v1/positions/x2", 404), "key b")
        log.look_up(Deed("a", "GET", "/v1/positions/x1", 404), "key a")


def test_what_was_refused_is_written_down_and_a_name_nobody_showed_is_marked(here: Api) -> None:
    token = sign_in(here, "viewer")
    wrong = {"password": "not this one", "new_password": "another password"}
    assert here.client.put("/v1/session/password", json=wrong, headers=token).status_code == 401
    assert noted(here, "PUT") == [("maria", "/v1/session/password", 401, 1)]
    for path in ("/v1/cameras/hall-east/still", "/v1/audit"):
        assert here.client.get(path, headers=token).status_code == 403
    assert sorted(noted(here)) == [("maria", "/v1/audit", 403, 1), ("maria", "/v1/cameras/hall-east/still", 403, 1)]
    claim = 'demo" (s-12345678)' + "x" * 100
    here.client.post("/v1/session", json={"user": claim, "password": PASSWORD}, headers={"Authorization": ""})
    who = here.client.get("/v1/audit?action=POST").json()["entries"][0]["who"]
    assert who == f'somebody who says "{claim.replace(chr(34), "�")[:64]}"'
    assert here.client.get("/v1/positions", headers=bearer("no-key")).status_code == 401
    assert len(noted(here)) == 2, "strangers cannot fill the log"


def test_a_stream_is_written_down_when_it_opens_and_when_it_ends(here: Api) -> None:
    with here.client.websocket_connect("/v1/ws?kinds=tracks&device=phone-3"):
        pass
    with here.client.websocket_connect("/v1/ws?kinds=camera"):
        pass
    entries: list[dict[str, Any]] = here.client.get("/v1/audit").json()["entries"]
    told = sorted((one["subject"], one["detail"]) for one in entries)
    assert told == [("/v1/ws?device=phone-3", "ended"), ("/v1/ws?device=phone-3", "opened: tracks")]


def test_one_key_opens_so_many_streams_and_leaves_the_others(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        guide = bearer(issue(here)["key"])
        with (
            here.client.websocket_connect("/v1/ws?kinds=tracks", headers=guide),
            here.client.websocket_connect("/v1/ws?kinds=tracks", headers=guide),
        ):
            refused = here.client.get("/v1/events?kinds=tracks", headers=guide)
            assert (refused.status_code, refused.headers["Retry-After"]) == (429, "5")
            with here.client.websocket_connect("/v1/ws?kinds=tracks"):
                pass


def test_alerts_name_phones_only_to_those_who_may_read_positions(here: Api) -> None:
    guard = bearer(issue(here, scopes=["alerts"])["key"])
    assert here.client.get("/v1/alerts?device=phone-3", headers=guard).status_code == 403
    assert here.client.get("/v1/events?device=phone-3", headers=guard).status_code == 403
    assert here.client.get("/v1/alerts", headers=guard).status_code == 200
    hook = bearer(issue(here, scopes=["webhooks"])["key"])
    wanted = json.dumps({"url": "https://203.0.113.9/x"})
    assert here.client.post("/v1/webhooks", content=wanted, headers=hook).status_code == 403


def test_a_track_that_may_be_somebodys_is_a_look_up_of_them(here: Api) -> None:
    here.people((None, 5.0, 5.0), runner_up=["phone-7"], sources=[["hall-east", "phone-8"]])
    assert here.client.get("/v1/tracks?limit=4").json()["tracks"][0]["runner_up"] == "phone-7"
    assert sorted(subject for _, subject, _, _ in noted(here)) == [
        "/v1/tracks?device=phone-7",
        "/v1/tracks?device=phone-8",
    ]


def test_who_may_not_see_phones_is_not_told_whom_rules_are_about(here: Api) -> None:
    rules = [
        {"id": "vip", "kind": "enter", "devices": ["phone-3", "phone-4"]},
        {"id": "near", "kind": "proximity", "limit": 2.0, "target": "phone-5"},
    ]
    zone = {"id": "vault", "floor": "ground", "points": [[1, 1], [3, 1], [3, 3]], "rules": rules}
    assert here.client.post("/v1/zones", json=zone).status_code == 201
    guard, staff = (
        bearer(issue(here, scopes=["site"])["key"]),
        bearer(issue(here, scopes=["site", "zones-admin"])["key"]),
    )
    for path in ("/v1/zones", "/v1/zones/vault", "/v1/zones?format=geojson", "/v1/zones/vault?format=geojson"):
        told, whole = (here.client.get(path, headers=who).text for who in (guard, staff))
        assert "phone-" not in told, path
        assert told.count("withheld") == whole.count("phone-") == 3
    assert here.client.get("/v1/zones", headers=guard).json()["zones"][-1]["rules"][0]["devices"] == ["withheld"] * 2


def test_an_erasure_keeps_the_look_ups_that_are_not_written_yet(here: Api) -> None:
    pseudonyms = Pseudonyms()
    log = AuditLog(here.admin.engine, days=1.0, pseudonyms=pseudonyms)
    for _ in range(2):
        log.look_up(Deed("a", "GET", "/v1/positions/phone-3", 200), "key a")
    pseudonyms.add("phone-3")
    log.look_up(Deed("a", "GET", "/v1/positions/phone-3", 200), "key a")
    log.erase(["phone-3"])
    assert [(row["subject"], row["times"]) for row in log.read(None, None, None, None, None, 10)] == [
        (pseudonyms.without("/v1/positions/phone-3"), 3)
    ]
