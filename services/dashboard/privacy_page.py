"""The page at ``/privacy``: what is known of people, for how long, and how it ends. Its life: ``static/privacy.js``."""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_privacy_page"]


def add_privacy_page(title: str, can_sign_out: bool) -> None:
    """Serve the page."""
    add_module_page("/privacy", "privacy", "Privacy", _BODY, title, can_sign_out)


_BODY = """
<section class="card" aria-labelledby="one-heading">
  <h2 id="one-heading">What is known of one phone</h2>
  <p class="quiet">For a visitor who asks: the id stands in their app.</p>
  <form id="privacy-form" class="controls">
    <label>Phone's id <input id="privacy-device" type="text" autocomplete="off" spellcheck="false" maxlength="64"
      required></label>
    <button type="submit" class="primary">Look up</button>
  </form>
  <div id="privacy-answer" role="status"></div>
</section>
<section class="card" aria-labelledby="erase-heading">
  <h2 id="erase-heading">Consent, and how it ends</h2>
  <p>Nobody's phone is located without their consent, which they give in the app to the text of
    <code>ATRIUM_CONSENT_FILE</code>. They take it back in the app, or with the token of their phone:
    <code>DELETE /v1/devices/ID</code> at the gateway, until 30 days after the token's end. Or staff do it here for a
    visitor who asks.</p>
  <p>Then its tokens die at once, and every store is told to forget the phone; what cameras saw stays, without a name.
    It cannot be undone.</p>
  <form id="erase-form" class="controls">
    <label>Phone's id <input id="erase-device" type="text" autocomplete="off" spellcheck="false" maxlength="64"
      required></label>
    <label>The id again, to be sure <input id="erase-again" type="text" autocomplete="off" spellcheck="false"
      maxlength="64" required></label>
    <button id="erase-button" type="submit" class="danger" disabled>Erase this phone</button>
  </form>
  <div id="erase-answer" role="status"></div>
</section>
<section class="card wide" aria-labelledby="gone-heading">
  <h2 id="gone-heading">Consents taken back <span class="count">and which stores have nothing of the phone</span></h2>
  <div id="privacy-erasures" class="scroll"><p class="empty">Asking…</p></div>
</section>
<section class="card wide" aria-labelledby="kept-heading">
  <h2 id="kept-heading">What is kept, and for how long</h2>
  <div id="privacy-kept" class="scroll"><p class="empty">Asking…</p></div>
  <p class="quiet">As the running services are set now. Heat maps and visits leave out, day by day, what fewer than
    five people did in a cell, at a zone, on a way; how many are in a zone is counted as it is, without names.
    Recordings, backups, what was exported or sent to webhooks, and the services' logs are the site's own to delete.</p>
</section>
"""
