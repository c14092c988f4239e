"""The page: what stands where. The live parts are filled by the modules in ``static/`` from ``/live``.

The lists are not NiceGUI tables on purpose: they share clock, colours and selection with the map, and times are shown
in the reader's own time zone, which only the browser knows.
"""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import FastAPI
from nicegui import core, ui

from services.dashboard.own_pages import from_here
from services.dashboard.page_header import header
from services.dashboard.web_app import STATIC

__all__ = ["add_page"]


def add_page(app: FastAPI, title: str, can_sign_out: bool) -> None:
    """Serve the live map at ``/`` of ``app``; NiceGUI allows this once per process."""

    @ui.page("/", title=f"{title} · Atrium", response_timeout=10.0)
    def live_map() -> None:
        ui.add_head_html('<link rel="stylesheet" href="/static/dashboard.css">')
        ui.add_body_html('<script type="module" src="/static/live.js"></script>')
        ui.query(".nicegui-content").classes(replace="atrium-page")
        header(title, can_sign_out, here="map")
        with ui.element("main").classes("atrium-main"):
            with ui.element("section").classes("atrium-map").props('aria-label="Floor plan"'):
                ui.html(_MAP, sanitize=False).classes("atrium-map-inner")
            with ui.element("aside").classes("atrium-side").props('aria-label="Alerts, phones and cameras"'):
                for name, heading, empty in _PANELS:
                    _panel(name, heading, empty)

    # NiceGUI answers pages of any origin otherwise.
    core.sio.eio.cors_allowed_origins = _ours
    ui.run_with(
        app,
        title="Atrium",
        favicon=STATIC / "favicon.svg",
        language="en-US",
        tailwind=False,
        binding_refresh_interval=None,
        show_welcome_message=False,
    )


def _ours(_: str | None, environ: Mapping[str, str]) -> bool:
    headers = {
        name: environ.get(f"HTTP_{name.upper().replace('-', '_')}") for name in ("sec-fetch-site", "origin", "host")
    }
    return from_here({name: value for name, value in headers.items() if value is not None})


_PANELS = (
    ("alerts", "Alerts", "Nothing has happened yet."),
    ("phones", "Located phones", "No phone is located now."),
    ("cameras", "Cameras", "This site has no camera."),
)


def _panel(name: str, heading: str, empty: str) -> None:
    spoken = ' aria-live="polite" aria-relevant="additions"' if name == "alerts" else ""
    with ui.element("section").classes("atrium-panel").props(f'aria-labelledby="{name}-heading"'):
        ui.html(
            f'<h2 id="{name}-heading">{heading} <span id="{name}-count" class="count"></span></h2>'
            f'<ul id="{name}" class="rows" data-empty="{empty}"{spoken}></ul>',
            sanitize=False,
        )


_MAP = """
<div id="atrium-banner" class="atrium-banner" role="alert" hidden></div>
<div class="atrium-toolbar">
  <label class="floor">Floor <select id="atrium-floor" aria-label="Floor shown on the map"></select></label>
  <fieldset id="atrium-layers"><legend class="unseen">Shown on the map</legend>
    <label><input type="checkbox" value="zones" checked> Zones</label>
    <label><input type="checkbox" value="cameras" checked> Cameras</label>
    <label><input type="checkbox" value="radio" checked> Access points</label>
    <label><input type="checkbox" value="trails" checked> Trails</label>
    <label><input type="checkbox" value="doubt" checked> Uncertainty</label>
  </fieldset>
  <span class="zoom">
    <button type="button" id="zoom-out" aria-label="Zoom out" title="Zoom out">−</button>
    <button type="button" id="zoom-in" aria-label="Zoom in" title="Zoom in">+</button>
    <button type="button" id="zoom-fit" title="Show the whole floor">Whole floor</button>
  </span>
</div>
<canvas id="atrium-canvas" tabindex="0" role="application" aria-label="Floor plan"
  title="Click a person to see who it is and why. Drag to move, wheel to zoom; the keys ← ↑ → ↓ + − 0 n p do so too"
  ></canvas>
<section id="atrium-evidence" class="atrium-evidence" aria-label="Who this is, and why" hidden></section>
"""
