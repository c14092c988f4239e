"""All pages whose life is a module of their own, and what they ask the API through."""

from __future__ import annotations

from fastapi import FastAPI

from services.dashboard.administration_page import add_administration_page
from services.dashboard.health_page import add_health_page
from services.dashboard.inbox_page import add_inbox_page
from services.dashboard.pass_through import pass_through
from services.dashboard.privacy_page import add_privacy_page
from services.dashboard.visits_page import add_visits_page
from services.dashboard.zones_page import add_zones_page

__all__ = ["add_pages"]


def add_pages(app: FastAPI, api_url: str, api_key: str, title: str, can_sign_out: bool, time_zone: str) -> None:
    """Serve them.

    Args:
        app: gets the routes they ask through.
        api_url: without a slash at the end.
        api_key: sent as a bearer token, never shown.
        title: name of the site.
        can_sign_out: whether people signed in.
        time_zone: the site's.
    """
    app.include_router(pass_through(api_url, api_key))
    add_inbox_page(title, can_sign_out)
    add_visits_page(title, can_sign_out, time_zone)
    add_zones_page(title, can_sign_out)
    add_health_page(title, can_sign_out)
    add_privacy_page(title, can_sign_out)
    add_administration_page(title, can_sign_out)
