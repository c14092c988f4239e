"""The page at ``/administration``: who may come in, where alerts are sent, who did what.

Its life is ``static/administration.js``; each part is there for a key with its scope only.
"""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_administration_page"]


def add_administration_page(title: str, can_sign_out: bool) -> None:
    """Serve the page."""
    add_module_page("/administration", "administration", "Administration", _BODY, title, can_sign_out)


def _part(name: str, heading: str) -> str:
    return f"""
<section class="card wide" aria-labelledby="{name}-heading">
  <h2 id="{name}-heading">{heading}</h2>
  <p id="{name}-said" class="quiet" role="status"></p>
  <div id="{name}-part" class="scroll"></div>
</section>
"""


_BODY = (
    _part("users", "Staff")
    + _part("keys", "Keys of programs")
    + _part("webhooks", "Webhooks")
    + _part("audit", "Who did what")
    + '<dialog id="administration-ask" class="ask"></dialog>'
)
