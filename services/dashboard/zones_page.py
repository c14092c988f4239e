"""The page at ``/zones``: zones with rules, and exhibits, drawn on the plan. Its life is ``static/zones.js``."""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_zones_page"]


def add_zones_page(title: str, can_sign_out: bool) -> None:
    """Serve the page."""
    add_module_page("/zones", "zones", "Zones", _BODY, title, can_sign_out)


_BODY = """
<section class="plan" aria-label="Floor plan with its zones">
  <div class="atrium-toolbar">
    <label class="floor">Floor <select id="zones-floor" aria-label="Floor shown"></select></label>
    <span class="tools">
      <button type="button" id="zones-area">New area</button>
      <button type="button" id="zones-line">New line</button>
      <button type="button" id="zones-point">New exhibit</button>
      <button type="button" id="zones-undo" title="Ctrl+Z">Undo</button>
      <button type="button" id="zones-redo" title="Ctrl+Shift+Z">Redo</button>
    </span>
    <label><input type="checkbox" id="zones-snap" checked> Snap</label>
    <span class="zoom">
      <button type="button" id="zones-out" aria-label="Zoom out" title="Zoom out">−</button>
      <button type="button" id="zones-in" aria-label="Zoom in" title="Zoom in">+</button>
      <button type="button" id="zones-fit" title="Show the whole floor">Whole floor</button>
    </span>
  </div>
  <canvas id="zones-canvas" tabindex="0" role="application" aria-label="Plan to draw on"
    aria-describedby="zones-hint"></canvas>
  <p id="zones-hint" class="hint" role="status"></p>
</section>
<aside class="side" aria-label="Zones and exhibits">
  <section class="card">
    <h2>Zones</h2>
    <p id="zones-problem" class="problem" role="alert" hidden></p>
    <ul id="zones-list" class="rows" data-empty="No zone on this floor yet. Draw one: New area, or New line."></ul>
  </section>
  <section class="card">
    <h2>Exhibits</h2>
    <ul id="zones-exhibits" class="rows" data-empty="No exhibit on this floor yet."></ul>
  </section>
  <section id="zones-form" class="card" hidden></section>
</aside>
<dialog id="zones-ask" class="ask"></dialog>
"""
