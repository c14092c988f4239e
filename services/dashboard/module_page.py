"""A page whose life is one module in ``static/``: what all of them have in common."""

from __future__ import annotations

import json
from html import escape
from typing import Any

from nicegui import ui

from services.dashboard.page_header import header

__all__ = ["add_module_page"]


def add_module_page(
    path: str, name: str, heading: str, body: str, title: str, can_sign_out: bool, **given: Any
) -> None:
    """Serve a page.

    Args:
        path: where.
        name: of its module, of its place in the header's list, and of its style class.
        heading: of the browser's tab.
        body: HTML inside ``<main>``; trusted.
        title: name of the site.
        can_sign_out: whether people signed in.
        given: what the module needs to know, as JSON in the attribute ``data-given`` of ``<main>``.
    """
    told = escape(json.dumps(given), quote=True)

    @ui.page(path, title=f"{heading} · {title} · Atrium", response_timeout=10.0)
    def module_page() -> None:
        ui.add_head_html('<link rel="stylesheet" href="/static/dashboard.css">')
        ui.add_head_html('<link rel="stylesheet" href="/static/pages.css">')
        ui.add_body_html(f'<script type="module" src="/static/{name}.js"></script>')
        ui.query(".nicegui-content").classes(replace=f"atrium-page {name}-page")
        header(title, can_sign_out, here=name)
        ui.html(f'<main id="{name}-main" class="page" data-given="{told}">{body}</main>', sanitize=False).classes(
            "page-frame"
        )
