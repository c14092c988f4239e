"""Who may come in beside the keys of the settings, how often, and what is written down about it."""

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from api_app import DEMO, Api, api
from sqlalchemy import text
from waiting import wait_until

from services.api.admin import accounts
from services.api.admin.accounts import MOST_SESSIONS
from services.api.admin.audit_log import FEW, AuditLog, Deed
from services.api.admin.passwords import hash_password, is_password
from services.api.pseudonyms import Pseudonyms
from services.api.settings import READ_SCOPES
from shared.withdrawal import WithdrawalAnswer, WithdrawalOrder

PASSWORD = "correct horse battery"
ZONE = {"id": "vault", "floor": "ground", "points": [[1.0, 6.0], [4.0, 6.0], [4.0, 9.0]]}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    monkeypatch.setattr("services.api.admin.passwords.LOG2_N", 4)
    monkeypatch.setattr("services.api.admin.accounts.NOBODY", hash_password("whoever it is"))
    with api(tmp_path) as made:
        yield made


def bearer(secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


def issue(here: Api, **wanted: Any) -> dict[str, Any]:
    reply = here.client.post("/v1/keys", json={"name": "guide-app", "scopes": ["positions"]} | wanted)
    assert reply.status_code == 201, reply.text
    told: dict[str, Any] = reply.json()
    return told


def sign_in(here: Api, role: str = "curator", name: str = "maria") -> dict[str, str]:
    here.client.post("/v1/users", json={"name": name, "role": role, "password": PASSWORD})
    reply = here.client.post("/v1/session", json={"user": name, "password": PASSWORD}, headers={"Authorization": ""})
    assert reply.status_code == 200, reply.text
    return bearer(reply.json()["token"])


def stored(here: Api) -> str:
    """All of the database as one text."""
    with here.admin.engine.connect() as connection:
        tables = ("api_keys", "api_users", "api_sessions", "api_audit", "api_definitions")
        return "\n".join(str(row) for table in tables for row in connection.execute(text(f"SELECT * FROM {table}")))


def test_a_key_is_told_once_opens_what_it_names_and_outlives_a_restart_but_not_its_end(
    here: Api, tmp_path: Path
) -> None:
    key = issue(here)
    secret = key["key"]
    assert secret not in stored(here)
    assert "key" not in here.client.get("/v1/keys").json()["keys"][0]
    assert here.client.get("/v1/positions", headers=bearer(secret)).status_code == 200
    refused = here.client.get("/v1/site", headers=bearer(secret))
    assert (refused.status_code, refused.json()["allowed"]) == (403, "a key with the scope site")
    with api(tmp_path) as later:
        assert later.client.get("/v1/positions", headers={"Authorization": "", "X-API-Key": secret}).status_code == 200
        assert later.client.delete(f"/v1/keys/{key['id']}").status_code == 204
        assert later.client.get("/v1/positions", headers=bearer(secret)).status_code == 401
        assert later.client.delete(f"/v1/keys/{key['id']}").status_code == 404


def test_an_expired_key_opens_nothing_and_says_why(here: Api) -> None:
    secret = issue(here, expires=time.time() + 1.5)["key"]
    assert here.client.get("/v1/positions", headers=bearer(secret)).status_code == 200
    wait_until(lambda: here.client.get("/v1/positions", headers=bearer(secret)).status_code == 401, 20.0, "its end")
    assert here.client.get("/v1/positions", headers=bearer(secret)).json()["found"] == "a key that has expired"


@pytest.mark.parametrize(
    ("wanted", "field"),
    [
        ({"scopes": []}, "scopes"),
        ({"scopes": ["everything"]}, "scopes"),
        ({"expires": 1.0}, "expires"),
        ({"expires": 1e999}, "body"),
        ({"expires": "tomorrow"}, "expires"),
        ({"rate": 0.0}, "rate"),
        ({"name": ""}, "name"),
        ({"name": "a\x00b"}, "name"),
        ({"name": " "}, "name"),
        ({"secret": "mine"}, "secret"),
    ],
)
def test_a_key_that_makes_no_sense_is_refused_by_field(here: Api, wanted: dict[str, Any], field: str) -> None:
    body = str({"name": "guide-app", "scopes": ["positions"]} | wanted).replace("'", '"').replace("\\x00", "\\u0000")
    reply = here.client.post("/v1/keys", content=body)
    assert reply.status_code == 422, reply.text
    assert reply.json()["field"].startswith(field)
    assert here.client.get("/v1/keys").json()["keys"] == []


def test_nobody_gives_away_more_than_they_have(here: Api) -> None:
    clerk = bearer(issue(here, scopes=["accounts", *READ_SCOPES])["key"])
    beyond = here.client.post("/v1/keys", json={"name": "x", "scopes": ["audit"]}, headers=clerk)
    assert (beyond.status_code, beyond.json()["field"]) == (403, "scopes")
    admin = {"name": "x", "role": "admin", "password": PASSWORD}
    assert here.client.post("/v1/users", json=admin, headers=clerk).status_code == 403
    assert here.client.post("/v1/users", json=admin | {"role": "viewer"}, headers=clerk).status_code == 201
    assert here.client.put("/v1/users/x", json={"role": "admin"}, headers=clerk).status_code == 403
    here.client.post("/v1/users", json=admin | {"name": "boss"})
    assert here.client.put("/v1/users/boss", json={"password": PASSWORD}, headers=clerk).status_code == 403
    assert here.client.delete("/v1/users/boss", headers=clerk).status_code == 403
    assert here.client.delete(f"/v1/keys/{issue(here, scopes=['audit'])['id']}", headers=clerk).status_code == 403
    assert here.client.delete(f"/v1/keys/{issue(here)['id']}", headers=clerk).status_code == 204
    assert here.client.get("/v1/users", headers=bearer(issue(here)["key"])).status_code == 403


@pytest.mark.parametrize(
    ("role", "may_draw", "may_let_in"),
    [("viewer", 403, 403), ("desk", 403, 403), ("curator", 201, 403), ("admin", 201, 200)],
)
def test_staff_may_do_what_their_role_says(here: Api, role: str, may_draw: int, may_let_in: int) -> None:
    token = sign_in(here, role)
    assert here.client.get("/v1/positions", headers=token).status_code == 200
    assert here.client.post("/v1/zones", json=ZONE, headers=token).status_code == may_draw
    assert here.client.get("/v1/users", headers=token).status_code == may_let_in
    me = here.client.get("/v1/session", headers=token).json()
    assert (me["name"], me["role"]) == ("maria", role)
    assert 11.9 < (me["expires"] - time.time()) / 3600.0 < 12.1


def test_a_sign_in_ends_when_one_leaves_or_is_changed_or_taken_out(here: Api, tmp_path: Path) -> None:
    token, other = sign_in(here), sign_in(here)
    assert token["Authorization"].split()[1] not in stored(here)
    with api(tmp_path) as later:
        assert later.client.get("/v1/session", headers=token).status_code == 200
    assert here.client.delete("/v1/session", headers=token).status_code == 204
    assert here.client.get("/v1/session", headers=token).status_code == 401
    assert here.client.get("/v1/session", headers=other).status_code == 200
    assert here.client.put("/v1/users/maria", json={"role": "viewer"}).status_code == 200
    assert here.client.get("/v1/session", headers=other).status_code == 401
    third = sign_in(here)
    assert here.client.delete("/v1/users/maria").status_code == 204
    assert here.client.get("/v1/session", headers=third).status_code == 401
    assert here.client.delete("/v1/session").status_code == 409, "a key is not a sign-in"


def test_one_changes_ones_own_password(here: Api) -> None:
    token = sign_in(here)
    wrong = {"password": "not this one", "new_password": "another password"}
    assert here.client.put("/v1/session/password", json=wrong, headers=token).status_code == 401
    right = wrong | {"password": PASSWORD}
    assert here.client.put("/v1/session/password", json=right, headers=token).status_code == 200
    assert here.client.get("/v1/session", headers=token).status_code == 401
    for password, status in ((PASSWORD, 401), ("another password", 200)):
        assert here.client.post("/v1/session", json={"user": "maria", "password": password}).status_code == status


def test_guessing_is_slowed_down_for_the_name_and_for_the_address(here: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    # How slowly a password is tried is not what is tested: a hundred tries would take ten seconds of a core.
    monkeypatch.setattr(accounts, "is_password", lambda *_: False)

    def attempt(name: str) -> Any:
        return here.client.post("/v1/session", json={"user": name, "password": "wrong"}, headers={"Authorization": ""})

    assert [attempt("maria").status_code for _ in range(10)] == [401] * 10
    slowed = attempt("maria")
    assert (slowed.status_code, 20 < int(slowed.headers["Retry-After"]) <= 30) == (429, True)
    assert [attempt(f"nobody-{n}").status_code for n in range(90)] == [401] * 90, "others may go on for a while"
    # A busy machine takes seconds for them, and every second second gives a try back.
    assert any(attempt(f"otto-{n}").status_code == 429 for n in range(100))
    every = here.client.get("/v1/audit?action=POST&limit=1000").json()["entries"]
    noted = [entry for entry in every if "otto" not in entry["who"]]
    assert [(e["who"], e["subject"], e["status"]) for e in noted[:1]] == [
        ('somebody who says "nobody-89"', "/v1/session", 401)
    ]
    assert len(noted) == 100, "what was not tried is not written down"


def test_a_stranger_who_guesses_does_not_lock_out_whose_name_it_is(here: Api) -> None:
    sign_in(here)

    def attempt(password: str, client: str, **headers: str) -> int:
        shown = DEMO | {"X-Atrium-Client": client} | headers
        return here.client.post("/v1/session", json={"user": "maria", "password": password}, headers=shown).status_code

    assert [attempt("wrong", "198.51.100.7") for _ in range(12)] == [401] * 10 + [429] * 2
    assert attempt(PASSWORD, "198.51.100.7") == 429
    assert attempt(PASSWORD, "browser of maria") == 200
    forged = [attempt("wrong", f"203.0.113.{n}", Authorization="Bearer no-key") for n in range(11)]
    assert forged == [401] * 10 + [429], "only the dashboard is believed for whom it asks"


def test_only_so_many_sign_ins_of_one_person_are_kept(here: Api) -> None:
    here.admin.accounts.let_in("maria", "viewer", PASSWORD)
    tokens = [here.admin.accounts.sign_in("maria", "viewer").token for _ in range(MOST_SESSIONS + 2)]
    alive = [here.client.get("/v1/session", headers=bearer(token)).status_code == 200 for token in tokens]
    assert alive == [False] * 2 + [True] * MOST_SESSIONS


def test_what_is_kept_of_a_password_tells_nothing_and_knows_it_again() -> None:
    kept = hash_password("ﬁsh and chips")
    assert "fish" not in kept
    assert kept != hash_password("ﬁsh and chips")
    assert is_password("fish and chips", kept), "the same letters, typed as other code points"
    assert not is_password("Fish and chips", kept)
    assert hash_password("x" * 10).startswith("scrypt$15$8$1$")
    with pytest.raises(ValueError, match="unknown kind"):
        is_password("x", "md5$1$1$1$eA==$eA==")


def test_a_key_may_ask_so_often_and_no_more_but_others_go_on(here: Api) -> None:
    slow, quick = (issue(here, rate=rate)["key"] for rate in (0.25, 1000.0))
    assert here.client.get("/v1/positions", headers=bearer(slow)).status_code == 200
    refused = here.client.get("/v1/positions", headers=bearer(slow))
    assert (refused.status_code, refused.headers["Retry-After"]) == (429, "4")
    assert {here.client.get("/v1/positions", headers=bearer(quick)).status_code for _ in range(50)} == {200}
    assert {here.client.get("/v1/positions").status_code for _ in range(50)} == {200}


def test_every_change_and_every_look_up_is_written_down_once_with_who_and_what(here: Api) -> None:
    here.people(("phone-1", 2.0, 7.0))
    guide = issue(here)
    assert here.client.get("/v1/positions", headers=bearer(guide["key"])).status_code == 200
    for _ in range(5):
        assert here.client.get("/v1/positions/phone-1", headers=bearer(guide["key"])).status_code == 200
    assert here.client.get("/v1/positions/phone-9", headers=bearer(guide["key"])).status_code == 404
    token = sign_in(here)
    here.client.post("/v1/zones", json=ZONE, headers=token)
    here.client.put("/v1/zones/vault", json=ZONE | {"name": "Vault"}, headers=token)
    here.client.put("/v1/zones/vault", json=ZONE | {"floor": "nowhere"}, headers=token)
    here.client.delete("/v1/zones/vault", headers=token)
    page = here.client.get("/v1/audit").json()
    who = f"guide-app ({guide['id']})"
    assert [(e["who"].split(" (s-")[0], e["action"], e["subject"], e["times"]) for e in reversed(page["entries"])] == [
        ("demo", "POST", f"/v1/keys/{guide['id']}", 1),
        ("demo", "POST", "/v1/users/maria", 1),
        ("maria", "POST", "/v1/session", 1),
        ("maria", "POST", "/v1/zones/vault", 1),
        ("maria", "PUT", "/v1/zones/vault", 1),
        ("maria", "DELETE", "/v1/zones/vault", 1),
        (who, "GET", "/v1/positions", 1),
        (who, "GET", "/v1/positions/phone-1", 5),
        (who, "GET", "/v1/positions/phone-9", 1),
    ]
    deleted = next(entry for entry in page["entries"] if entry["action"] == "DELETE")
    assert '"name":"Vault"' in deleted["detail"], "what there was before"
    assert PASSWORD not in stored(here)
    assert guide["key"] not in stored(here)


def test_the_audit_log_is_read_in_pages_by_those_who_may(here: Api) -> None:
    for number in range(5):
        here.client.post("/v1/zones", json=ZONE | {"id": f"z{number}"})
    first = here.client.get("/v1/audit?limit=3").json()
    rest = here.client.get(f"/v1/audit?limit=3&before={first['next']}").json()
    subjects = [entry["subject"] for page in (first, rest) for entry in page["entries"]]
    assert subjects == [f"/v1/zones/z{number}" for number in (4, 3, 2, 1, 0)]
    assert rest["next"] is None
    assert here.client.get("/v1/audit?who=x' OR 1=1 --").json()["entries"] == []
    assert here.client.get("/v1/audit?who=%00").json()["entries"] == []
    assert here.client.get("/v1/audit?limit=0").status_code == 422
    assert here.client.get("/v1/audit", headers=sign_in(here)).status_code == 403


def test_look_ups_within_a_minute_are_one_row_and_old_rows_are_forgotten(here: Api) -> None:
    now = [1000.0]
    log = AuditLog(here.admin.engine, days=1.0, pseudonyms=Pseudonyms(), clock=lambda: now[0])
    deed = Deed("guide", "GET", "/v1/positions/phone-1", 200)
    for at in (1000.0, 1030.0, 1059.0, 1061.0, 1062.0):
        now[0] = at
        log.look_up(deed)
        log.keep()
    rows = log.read(None, None, None, None, None, 10)
    assert [(row["t"], row["times"]) for row in rows] == [(1030.0, 4), (1000.0, 1)]
    now[0] = 1030.0 + 86400.0
    log.keep()
    assert [row["t"] for row in log.read(None, None, None, None, None, 10)] == [1030.0]


def test_an_erased_phone_is_another_name_in_log_and_rules_and_stays_one(here: Api) -> None:
    here.people(("phone-1", 2.0, 7.0), ("phone-12", 3.0, 7.0))
    rules = [
        {"id": "near", "kind": "proximity", "limit": 2.0, "target": "phone-1"},
        {"id": "only", "kind": "enter", "devices": ["phone-1", "phone-12"]},
    ]
    zone = ZONE | {"rules": rules}
    path = here.client.post("/v1/zones", json=zone).headers["Location"]
    assert here.client.put(path, json=zone | {"name": "After"}).status_code == 200
    look_ups = ("positions/phone-1", "positions/phone-12", "positions/phone-1/exhibits")
    for look_up in (*look_ups, "alerts?device=phone-1", "alerts?device=phone-12"):
        assert here.client.get(f"/v1/{look_up}").status_code == 200
    assert here.admin.keep() is None
    here.client.get("/v1/positions/phone-1")
    here.pseudonyms.add("phone-1")
    here.admin.erase("phone-1")
    assert here.admin.keep() is None
    assert here.erased == [], "the map still shows the rules as they were"
    asyncio.run(here.admin.follow_zones())
    assert here.admin.keep() is None
    assert here.erased == ["phone-1"]
    here.client.put(path, json=zone | {"name": "Of a page that was open before"})
    here.client.get("/v1/alerts?device=phone-1")
    name = here.pseudonyms.of("phone-1")
    entries = here.client.get("/v1/audit").json()["entries"]
    assert sorted((entry["action"], entry["subject"], entry["times"]) for entry in entries) == sorted(
        [
            ("GET", "/v1/positions/phone-12", 1),
            ("GET", f"/v1/positions/{name}", 2),
            ("GET", f"/v1/positions/{name}/exhibits", 1),
            ("GET", "/v1/alerts?device=phone-12", 1),
            ("GET", f"/v1/alerts?device={name}", 2),
            ("POST", path, 1),
            ("PUT", path, 1),
            ("PUT", path, 1),
        ]
    )
    before = [entry["detail"] for entry in entries if entry["action"] == "PUT"]
    assert all(name in text and '"phone-12"' in text and '"phone-1"' not in text for text in before)
    kept = here.client.get(path).json()["rules"]
    assert (kept[0]["target"], kept[1]["devices"]) == (name, [name, "phone-12"]), "a rule of one is none of everybody"
    assert msgspec.json.encode(here.published.sets[-1].zones).count(b'"phone-1"') == 0


def test_many_are_erased_at_once_as_one_is(here: Api) -> None:
    gone = [f"d-{number}" for number in range(FEW + 1)]
    for device in gone:
        here.admin.audit.record(Deed("maria", "DELETE", f"/v1/devices/{device}", 202))
        here.pseudonyms.add(device)
        here.admin.erase(device)
    assert here.admin.keep() is None
    subjects = {entry["subject"] for entry in here.client.get("/v1/audit").json()["entries"]}
    assert subjects == {f"/v1/devices/{here.pseudonyms.of(device)}" for device in gone}


def test_staff_erase_a_phone_with_the_scope_and_hear_when_that_was_not_possible(here: Api) -> None:
    away = here.client.delete("/v1/devices/d-1")
    assert (away.status_code, away.headers["Retry-After"]) == (503, "5")
    asked: list[WithdrawalOrder] = []
    outcomes = iter(("unknown", "away", "withdrawn", "withdrawn"))

    def ask(_key: str, _patience: float, payload: bytes | None) -> bytes:
        asked.append(msgspec.json.decode(payload or b"", type=WithdrawalOrder))
        return msgspec.json.encode(WithdrawalAnswer(outcome=next(outcomes), t=9.0))  # type: ignore[arg-type]

    here.ask = ask
    clerk = sign_in(here, "desk")
    assert [here.client.delete("/v1/devices/d-1", headers=clerk).status_code for _ in range(4)] == [404, 503, 202, 202]
    assert asked[0] == WithdrawalOrder(device="d-1", by="maria")
    curator = here.client.delete("/v1/devices/d-1", headers=sign_in(here, "curator", "otto"))
    assert (curator.status_code, curator.json()["allowed"]) == (403, "a key with the scope erase")
    deeds = here.client.get("/v1/audit?action=DELETE").json()["entries"]
    assert [(deed["who"].split()[0], deed["subject"], deed["status"]) for deed in deeds] == [
        ("otto", "/v1/devices/d-1", 403),
        *[("maria", "/v1/devices/d-1", 202)] * 2,
    ]


def test_nobody_is_looked_up_unseen_when_the_log_cannot_be_written(here: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.api.admin.audit_log.MOST_OPEN", 3)
    here.people(("a", 2.0, 7.0), ("b", 3.0, 7.0), ("c", 4.0, 7.0), ("d", 4.0, 8.0))
    statuses = [here.client.get(f"/v1/positions/{device}").status_code for device in "abdca"]
    assert statuses == [200, 200, 200, 503, 200]
    assert here.client.get("/v1/site").status_code == 200


def test_the_last_admin_stays(here: Api) -> None:
    sign_in(here, "admin", "boss")
    assert here.client.delete("/v1/users/boss").json()["type"] == "urn:atrium:last-admin"
    assert here.client.put("/v1/users/boss", json={"role": "viewer"}).status_code == 409
    assert here.client.put("/v1/users/boss", json={"password": PASSWORD}).status_code == 200
    sign_in(here, "admin", "heir")
    assert here.client.delete("/v1/users/boss").status_code == 204


def test_what_was_changed_from_the_command_line_is_heard_within_a_minute(here: Api) -> None:
    token, now = sign_in(here), [time.time()]
    elsewhere = accounts.Accounts(here.admin.engine, 1.0, 1.0)
    elsewhere.shut_out("maria")
    here.admin.accounts._clock = lambda: now[0]
    assert here.admin.keep() is None
    assert here.client.get("/v1/session", headers=token).status_code == 200
    now[0] += 61.0
    assert here.admin.keep() is None
    assert here.client.get("/v1/session", headers=token).status_code == 401


def test_a_key_tells_in_which_hour_it_was_used_last(here: Api, tmp_path: Path) -> None:
    key = issue(here)
    assert here.client.get("/v1/keys").json()["keys"][0]["last_used"] is None
    here.client.get("/v1/positions", headers=bearer(key["key"]))
    used = here.client.get("/v1/keys").json()["keys"][0]["last_used"]
    assert (used % 3600.0, -10.0 <= time.time() - used < 3610.0) == (0.0, True)
    assert here.admin.keep() is None
    with api(tmp_path) as later:
        assert later.client.get("/v1/keys").json()["keys"][0]["last_used"] == used


def test_all_sign_ins_of_a_person_share_one_ration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.api.admin.passwords.LOG2_N", 4)
    with api(tmp_path, session_rate=0.25) as here:
        first, second = sign_in(here), sign_in(here)
        asked = [here.client.get("/v1/site", headers=token).status_code for token in (first, second)]
        assert asked == [200, 429]


def test_the_demo_key_still_may_do_everything(here: Api) -> None:
    assert here.client.get("/v1/session", headers=DEMO).json()["role"] is None
    assert here.client.post("/v1/zones", json=ZONE).status_code == 201


def test_placing_access_points_needs_to_read_the_site_and_to_set_it_up(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        for scopes, status in ((["setup"], 403), (["site"], 403), (["setup", "site"], 422)):
            shown = {"Authorization": f"Bearer {issue(here, scopes=scopes)['key']}"}
            assert here.client.post("/v1/access-points", content=b"{}", headers=shown).status_code == status


@pytest.mark.parametrize(
    ("path", "order", "status", "field"),
    [
        ("keys", {"name": "far", "scopes": ["site"], "expires": 4_102_444_800_000}, 422, "expires"),
        ("users", {"name": "weak", "role": "guard", "password": "aaaaaaaaaaaa"}, 422, "password"),
        ("users", {"name": "weak", "role": "guard", "password": "atrium-admin1"}, 422, "password"),
        ("users", {"name": "MARIA", "role": "guard", "password": PASSWORD}, 409, "name"),
    ],
)
def test_what_is_guessed_or_mistaken_is_refused(
    here: Api, path: str, order: dict[str, Any], status: int, field: str
) -> None:
    here.client.post("/v1/users", json={"name": "maria", "role": "admin", "password": PASSWORD})
    told = here.client.post(f"/v1/{path}", json=order)
    assert (told.status_code, told.json()["field"]) == (status, field)
