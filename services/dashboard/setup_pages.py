"""The pages at ``/camera-setup`` and ``/access-points``: what stands where; modules in ``static/`` do the rest.

What is pointed at is pointed at in the browser, several times a second: the server would only be in between.
"""

from __future__ import annotations

from nicegui import ui

from services.dashboard.page_header import header

__all__ = ["add_setup_pages"]


def add_setup_pages(title: str, can_sign_out: bool) -> None:
    """Serve both pages; ``setup_relay`` carries what they ask.

    Args:
        title: name of the site.
        can_sign_out: whether people signed in.
    """

    @ui.page("/camera-setup", title=f"Camera set-up · {title} · Atrium", response_timeout=10.0)
    def camera_setup() -> None:
        _page(title, can_sign_out, "camera-setup", _CAMERA)

    @ui.page("/access-points", title=f"Access points · {title} · Atrium", response_timeout=10.0)
    def access_points() -> None:
        _page(title, can_sign_out, "access-points", _POINTS)


def _page(title: str, can_sign_out: bool, name: str, content: str) -> None:
    ui.add_head_html('<link rel="stylesheet" href="/static/dashboard.css">')
    ui.add_head_html('<link rel="stylesheet" href="/static/setup.css">')
    ui.add_body_html(f'<script type="module" src="/static/{name}.js"></script>')
    ui.query(".nicegui-content").classes(replace="atrium-page setup-page")
    header(title, can_sign_out, here=name)
    with ui.element("main").classes("setup-main"):
        ui.html(content, sanitize=False).classes("setup")


def _number(name: str, label: str, value: str) -> str:
    return f'<label>{label} <input type="number" name="{name}" step="any" value="{value}" required></label>'


_KEYS = "Arrow keys move a crosshair (with Shift finely), Enter sets the point, + − zoom, 0 shows all"
_RECTANGLE = "".join(
    (
        _number("x", "First corner x", "0"),
        _number("y", "y", "0"),
        _number("angle", "Direction to the second, °", "0"),
        _number("width", "Width, m", "1"),
        _number("depth", "Depth, m", "1"),
    )
)
_BOARD = "".join(
    (
        _number("columns", "Inner corners across", "9"),
        _number("rows", "down", "6"),
        _number("square", "Square, m", "0.1"),
        _number("x", "First corner x", "0"),
        _number("y", "y", "0"),
        _number("angle", "Direction of its first row, °", "0"),
    )
)
_CAMERA = f"""
<div class="bar">
  <label>Camera <select id="setup-camera"></select></label>
  <button type="button" id="setup-still" class="main">Take a picture</button>
  <label>or open a file <input type="file" id="setup-file" accept="image/*"></label>
  <fieldset id="setup-mode"><legend class="unseen">What clicks in the picture mean</legend>
    <label><input type="radio" name="mode" value="pairs" checked> Pairs of points</label>
    <label><input type="radio" name="mode" value="interest"> Area of interest</label>
  </fieldset>
  <label hidden><input type="checkbox" id="setup-lens" checked> Use the calibrated lens</label>
  <button type="button" id="setup-save" class="main">Save</button>
  <p id="setup-lacking" class="note" hidden></p>
  <p id="setup-say" class="say" role="status" aria-live="polite"></p>
</div>
<div class="sides">
  <section aria-label="Picture"><canvas id="setup-image" tabindex="0" role="application"
    aria-label="Picture of the camera. {_KEYS}" title="{_KEYS}"></canvas></section>
  <section aria-label="Plan"><canvas id="setup-plan" class="plan" tabindex="0" role="application"
    aria-label="Floor plan. {_KEYS}" title="{_KEYS}"></canvas></section>
</div>
<section aria-labelledby="pairs-heading">
  <h2 id="pairs-heading">Pairs <span>a place on the floor in the picture, and the same place on the plan</span></h2>
  <ul id="setup-told" class="told" aria-live="polite"></ul>
  <div class="scroll"><table class="cards">
    <thead><tr><th>Pair</th><th>u, px</th><th>v, px</th><th>x, m</th><th>y, m</th><th>Off</th>
      <th>Off by the others</th><th><span class="unseen">Remove</span></th></tr></thead>
    <tbody id="setup-pairs"></tbody>
  </table></div>
  <details><summary>A rectangle of known size on the floor</summary>
    <form id="setup-rectangle">{_RECTANGLE}<button>Add its corners</button></form></details>
  <details><summary>A checkerboard lying on the floor</summary>
    <form id="setup-board">{_BOARD}<label><input type="checkbox" name="turned"> begin at its other end</label>
    <button>Find it</button></form></details>
</section>
<section aria-labelledby="interest-heading">
  <h2 id="interest-heading">Area of interest <span>feet outside it are ignored</span></h2>
  <p class="note" id="setup-interest"></p>
  <button type="button" id="setup-undo">Take back a corner</button>
  <button type="button" id="setup-whole">The whole picture</button>
</section>
"""
_POINTS = f"""
<div class="bar">
  <label>Floor <select id="points-floor"></select></label>
  <button type="button" id="points-save" class="main">Save</button>
  <p id="points-lacking" class="note" hidden></p>
  <p id="points-say" class="say" role="status" aria-live="polite"></p>
</div>
<div class="sides">
  <section aria-label="Plan"><canvas id="points-plan" class="plan" tabindex="0" role="application"
    aria-label="Floor plan. {_KEYS}" title="{_KEYS}"></canvas></section>
  <section aria-labelledby="points-heading">
    <h2 id="points-heading">Access points <span>metres; z above this floor</span></h2>
    <div class="scroll"><table class="places">
      <thead><tr><th>Access point</th><th>x</th><th>y</th><th>z</th>
        <th><span class="unseen">State</span></th></tr></thead>
      <tbody id="points-list"></tbody>
    </table></div>
  </section>
</div>
"""
