"""What the API keeps, in a real PostgreSQL server that goes away for a while; and databases that are not ready."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from api_app import SITE, api
from postgres_server import PostgresServer, postgres
from pydantic import SecretStr

from services.api.admin.administration import Administration
from services.api.admin.database import migrate, open_admin
from services.api.live_state import LiveState
from services.api.settings import ApiSettings
from shared.runner import ServiceError
from shared.site import load_site

ZONE = {"id": "vault", "floor": "ground", "points": [[1.0, 6.0], [4.0, 6.0], [4.0, 9.0]]}
TEXT = "'; DROP TABLE api_keys; -- \\ ☃ <script>"


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with postgres() as started:
        yield started


def test_a_server_that_goes_away_holds_up_no_read_and_loses_nothing(server: PostgresServer, tmp_path: Path) -> None:
    with api(tmp_path, api_database_url=server.url) as here:
        here.people(("phone-1", 2.0, 7.0))
        assert here.client.post("/v1/zones", json=ZONE | {"name": TEXT}).status_code == 201
        key = here.client.post("/v1/keys", json={"name": TEXT[:40], "scopes": ["positions"]}).json()
        staff = {"name": "maria", "role": "guard", "password": "correct horse battery"}
        assert here.client.post("/v1/users", json=staff).status_code == 201
        assert here.client.post("/v1/users", json=staff).status_code == 409
        token = here.client.post("/v1/session", json={"user": "maria", "password": staff["password"]}).json()["token"]
        server.stop()
        guide, guard = ({"Authorization": f"Bearer {secret}"} for secret in (key["key"], token))
        assert here.client.get("/v1/positions", headers=guide).status_code == 200
        assert here.client.get("/v1/positions/phone-1", headers=guide).status_code == 200
        assert here.client.get("/v1/zones", headers=guard).status_code == 200
        reason = here.admin.keep()
        assert reason is not None
        assert "postgresql" in reason
        for method, path in (
            ("POST", "/v1/zones"),
            ("PUT", "/v1/zones/vault"),
            ("DELETE", "/v1/zones/vault"),
            ("GET", "/v1/keys"),
            ("GET", "/v1/audit"),
            ("DELETE", f"/v1/keys/{key['id']}"),
        ):
            reply = here.client.request(method, path, json=ZONE | {"id": "vault" if method == "PUT" else "other"})
            assert (reply.status_code, reply.headers.get("Retry-After")) == (503, "5"), (method, path)
        assert here.client.get("/v1/positions", headers=guide).status_code == 200, "a key that was not revoked holds"
        server.start()
        assert here.admin.keep() is None
        looked_up = here.client.get("/v1/audit?action=GET").json()["entries"]
        guides = f"{TEXT[:40]} ({key['id']})"
        assert {(e["who"], e["subject"], e["times"]) for e in looked_up} == {
            (guides, "/v1/positions/phone-1", 1),
            (guides, "/v1/positions", 2),
        }
        assert here.client.put("/v1/zones/vault", json=ZONE | {"name": "again"}).status_code == 200
    with api(tmp_path, api_database_url=server.url) as later:
        assert later.client.get("/v1/zones/vault").json()["name"] == "again"
        assert later.client.get("/v1/positions", headers=guide).status_code == 200
        assert later.client.delete("/v1/zones/vault", headers=guard).status_code == 403
        assert later.client.delete("/v1/users/maria").status_code == 204
        assert later.client.get("/v1/zones", headers=guard).status_code == 401


def test_outside_the_demo_a_database_without_tables_is_refused_with_what_to_do(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/new.db"
    settings = ApiSettings(site_file=SITE, api_database_url=SecretStr(url))
    site = load_site(SITE)
    with pytest.raises(ServiceError, match="atrium migrate"):
        Administration.open(settings, site, LiveState(site, 1.0, 1.0))
    migrate(url)
    Administration.open(settings, site, LiveState(site, 1.0, 1.0))


@pytest.mark.parametrize("url", ["nonsense", "postgresql://atrium:hidden-word@127.0.0.1:9/none?connect_timeout=2"])
def test_a_database_that_cannot_be_reached_is_named_without_its_password(url: str) -> None:
    with pytest.raises(ServiceError) as caught:
        open_admin(url)
    assert "hidden-word" not in str(caught.value)
    assert "api_database_url" in str(caught.value) or "127.0.0.1" in str(caught.value)
