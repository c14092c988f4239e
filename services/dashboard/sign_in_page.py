"""The sign-in page: a name of the staff and their password, or the shared password alone."""

from __future__ import annotations

import html

from fastapi.responses import HTMLResponse

from services.dashboard.staff_desk import Refused

__all__ = ["sign_in_page"]


def sign_in_page(shared: bool, refused: Refused | None = None, name: str = "") -> HTMLResponse:
    """Return the page.

    Args:
        shared: whether there is a shared password, for which the name is left empty.
        refused: why the last attempt failed.
        name: what was typed then.
    """
    note = f'<p class="problem" role="alert">{html.escape(refused.words)}</p>' if refused else ""
    hint = "Leave the name empty for the shared password." if shared else "Ask an admin if you have none."
    page = (
        _PAGE.replace("{required}", "" if shared else " required")
        .replace("{hint}", hint)
        .replace("{note}", note)
        .replace("{name}", html.escape(name[:200], quote=True))
    )
    headers = {"Cache-Control": "no-store"}
    if refused is not None and refused.wait:
        headers["Retry-After"] = str(refused.wait)
    return HTMLResponse(page, refused.status if refused else 200, headers)


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Atrium: sign in</title>
<link rel="icon" href="/static/favicon.svg">
<link rel="stylesheet" href="/static/dashboard.css">
</head>
<body class="sign-in">
<main>
<form method="post" action="/login">
<h1>Atrium</h1>
<label for="name">Name</label>
<input id="name" name="name" type="text" autocomplete="username" autocapitalize="none" spellcheck="false"
  maxlength="64" value="{name}" aria-describedby="hint"{required} autofocus>
<p id="hint" class="hint">{hint}</p>
<label for="password">Password</label>
<input id="password" name="password" type="password" autocomplete="current-password" required>
{note}
<button type="submit">Sign in</button>
</form>
</main>
</body>
</html>
"""
