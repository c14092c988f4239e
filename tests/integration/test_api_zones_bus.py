"""Zones that staff draw reach whoever listens on the bus, also those who come later, also after a restart."""

from pathlib import Path

import httpx
from api_in_process import running
from waiting import wait_until

from shared.bus import Bus, Inbox
from shared.keys import Keys
from shared.site import load_site
from shared.zones import ZoneSet

KEY = {"Authorization": "Bearer demo-api-key"}
ZONE = {"id": "vault", "floor": "ground", "points": [[1.0, 6.0], [4.0, 6.0], [4.0, 9.0]]}


def told(inbox: Inbox) -> list[list[str]]:
    sets = [delivery.message for delivery in inbox.receive(timeout=0.1)]
    return [[zone.id for zone in one.zones] for one in sets if isinstance(one, ZoneSet)]


def test_zones_are_published_and_kept_for_late_comers(
    project: Path, zenoh_router: str, free_port: int, tmp_path: Path
) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    url = f"sqlite:///{tmp_path}/api.db"
    with running(site, project, zenoh_router, free_port, api_database_url=url) as address, Bus([zenoh_router]) as bus:
        made = httpx.post(f"{address}/v1/zones", headers=KEY, json=ZONE)
        assert made.status_code == 201
        late = bus.inbox()
        late.subscribe(Keys(site.site).zones(), ZoneSet, cached=True)
        assert wait_until(lambda: told(late), 10.0, "the zones") == [["entrance", "model-corner", "vault"]]
        assert httpx.delete(f"{address}/v1/zones/entrance", headers=KEY).status_code == 204
        assert wait_until(lambda: told(late), 10.0, "the change") == [["model-corner", "vault"]]
    with (
        Bus([zenoh_router]) as bus,
        running(site, project, zenoh_router, free_port, api_database_url=url) as address,
    ):
        later = bus.inbox()
        later.subscribe(Keys(site.site).zones(), ZoneSet, cached=True)
        assert wait_until(lambda: told(later), 10.0, "the zones after a restart") == [["model-corner", "vault"]]


def test_a_key_that_may_read_zones_may_not_change_them(project: Path, zenoh_router: str, free_port: int) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    keys = '[{"name": "map", "key": "map-app-key-000001", "scopes": ["site"]}]'
    reader = {"X-API-Key": "map-app-key-000001"}
    with running(site, project, zenoh_router, free_port, api_keys=keys) as address:
        for method, path in (("POST", ""), ("PUT", "/entrance"), ("DELETE", "/entrance")):
            for kind in ("zones", "exhibits"):
                refused = httpx.request(method, f"{address}/v1/{kind}{path}", headers=reader, json=ZONE)
                assert (refused.status_code, refused.json()["allowed"]) == (403, "a key with the scope zones-admin")
        assert httpx.get(f"{address}/v1/zones/entrance", headers=reader).status_code == 200
