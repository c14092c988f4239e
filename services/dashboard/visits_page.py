"""The page at ``/visits``: where people linger, how many, where they go next. Its life is ``static/visits.js``."""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_visits_page"]


def add_visits_page(title: str, can_sign_out: bool, time_zone: str) -> None:
    """Serve the page; ``time_zone`` is the site's, by which its days are cut."""
    body = _CONTROLS + "".join(_card(*card) for card in _CARDS)
    add_module_page("/visits", "visits", "Visits", body, title, can_sign_out, time_zone=time_zone, site=title)


_CONTROLS = """
<section class="card wide" aria-label="Period and floor">
  <div class="controls">
    <label>Period <select id="visits-period">
      <option value="0">today</option>
      <option value="1">yesterday</option>
      <option value="7">the last 7 days</option>
      <option value="30">the last 30 days</option>
      <option value="other">from … to …</option>
    </select></label>
    <span id="visits-other" class="controls" hidden>
      <label>From <input type="datetime-local" id="visits-since"></label>
      <label>To <input type="datetime-local" id="visits-until"></label>
    </span>
    <label class="floor">Floor <select id="visits-floor"></select></label>
    <label>Cells of <select id="visits-cell">
      <option value="0.5">0.5 m</option><option value="1">1 m</option><option value="2">2 m</option>
    </select></label>
    <label>Stays and ways at <select id="visits-at">
      <option value="zones">zones</option><option value="exhibits">exhibits</option>
    </select></label>
    <span id="visits-told" class="quiet" role="status"></span>
  </div>
</section>
"""

_CARDS = (
    ("heat", "Where people stay", "Time that all people together spent in each cell.", "wide"),
    ("occupancy", "How many people", "In each zone, in the mean of each step.", "wide"),
    (
        "dwell",
        "How long they stay",
        "Half of the visits are shorter than the median. Who is lost from view and found again counts anew.",
        "",
    ),
    ("flows", "Where they go next", "How often people went from the place of the row to that of the column.", ""),
)


def _card(name: str, heading: str, caption: str, width: str) -> str:
    return f"""
<section class="card {width}" aria-labelledby="{name}-heading">
  <h2 id="{name}-heading">{heading} <span class="count">{caption}</span></h2>
  <p id="{name}-problem" class="empty" role="status">Asking…</p>
  <canvas id="{name}-picture" class="picture" role="img" hidden></canvas>
  <div id="{name}-table" class="scroll"></div>
  <div class="orders">
    <button type="button" id="{name}-png" disabled>Save the picture</button>
    <button type="button" id="{name}-csv" disabled>Save the numbers</button>
  </div>
</section>
"""
