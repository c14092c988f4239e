"""The page at ``/health``: does it all work, and what does not? Its life is ``static/health.js``."""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_health_page"]


def add_health_page(title: str, can_sign_out: bool) -> None:
    """Serve the page."""
    add_module_page("/health", "health", "Health", _BODY, title, can_sign_out)


_BODY = """
<section class="card wide" aria-labelledby="health-heading">
  <h2 id="health-heading">Is it well?</h2>
  <p id="health-verdict" class="verdict" role="status">Asking…</p>
  <ul id="health-problems" class="problems"></ul>
</section>
<section class="card" aria-labelledby="areas-heading">
  <h2 id="areas-heading">Areas</h2><div id="health-areas" class="scroll"></div>
</section>
<section class="card" aria-labelledby="cams-heading">
  <h2 id="cams-heading">Cameras</h2><div id="health-cameras" class="scroll"></div>
</section>
<section class="card wide" aria-labelledby="services-heading">
  <h2 id="services-heading">Programs</h2><div id="health-services" class="scroll"></div>
</section>
"""
