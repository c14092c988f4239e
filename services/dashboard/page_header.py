"""What stands on top of every page: whose site it is, the way to the other pages, and the way out."""

from __future__ import annotations

from html import escape

from nicegui import ui

from services.dashboard.sessions import Visitor, asked_by

__all__ = ["header", "page_visitor"]

PAGES = {
    "map": ("/", "Live map"),
    "inbox": ("/alerts", "Alerts"),
    "visits": ("/visits", "Visits"),
    "zones": ("/zones", "Zones"),
    "camera-setup": ("/camera-setup", "Cameras"),
    "access-points": ("/access-points", "Access points"),
    "learning": ("/learning", "Learning"),
    "health": ("/health", "Health"),
    "privacy": ("/privacy", "Privacy"),
}


def page_visitor() -> Visitor:
    """Return whose browser the page is built for."""
    return asked_by(ui.context.client.request, "")


def header(title: str, can_sign_out: bool, here: str) -> None:
    """Draw it.

    Args:
        title: name of the site.
        can_sign_out: whether people signed in.
        here: which of ``PAGES`` this is; the live map tells its status here, too.
    """
    with ui.element("header").classes("atrium-header"):
        ui.html('<span class="atrium-brand">Atrium</span>', sanitize=False)
        ui.label(title).classes("atrium-site")
        links = "".join(
            f'<a href="{address}"{" aria-current=page" if name == here else ""}>{words}</a>'
            for name, (address, words) in PAGES.items()
        )
        ui.html(f'<nav aria-label="Pages">{links}</nav>', sanitize=False).classes("atrium-nav")
        if here == "map":
            status = '<span id="atrium-status" class="atrium-status">Connecting…</span>'
            ui.html(status, sanitize=False).classes("atrium-told")
        if can_sign_out:
            ui.add_body_html('<script type="module" src="/static/session.js"></script>')
            visitor = page_visitor()
            who = f"<span>{escape(visitor.name)} ({escape(visitor.role)})</span> " if visitor.name else ""
            out = f'<form method="post" action="/logout">{who}<button>Sign out</button></form>'
            ui.html(out, sanitize=False).classes("atrium-out")
