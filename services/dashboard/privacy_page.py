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
    <code>DELETE /v1/devices/ID</code> at the gateway, until 30 days after the token's end.</p>
  <p>Then its tokens die at once, and every store is told to forget the phone; what cameras saw stays, without a name.
    Staff cannot do it for somebody: the gateway takes the visitor's own word only.</p>
</section>
<section class="card wide" aria-labelledby="gone-heading">
  <h2 id="gone-heading">Consents taken back <span class="count">and which stores have nothing of the phone</span></h2>
  <div id="privacy-erasures" class="scroll"><p class="empty">Asking…</p></div>
</section>
<section class="card wide" aria-labelledby="kept-heading">
  <h2 id="kept-heading">What is kept, and for how long</h2>
  <div class="scroll"><table class="kept">
    <thead><tr><th scope="col">What</th><th scope="col">How long</th><th scope="col">Setting</th></tr></thead>
    <tbody>
      <tr><th scope="row">Pictures</th>
        <td>in the camera's own memory, 5 minutes, shrunk; on no disk, unless one is set for the empty scene</td>
        <td><code>ATRIUM_RING_MINUTES</code>, <code>ATRIUM_SCENE_FILE</code></td></tr>
      <tr><th scope="row">Where everybody is now</th><td>10 seconds after they were last seen</td>
        <td><code>ATRIUM_TRACKS_KEPT</code></td></tr>
      <tr><th scope="row">Where a phone was last</th><td>2 minutes</td><td><code>ATRIUM_POSITIONS_KEPT</code></td></tr>
      <tr><th scope="row">Where phones were</th><td>30 days</td><td><code>ATRIUM_HISTORY_PHONE_DAYS</code></td></tr>
      <tr><th scope="row">Where people without names were</th><td>90 days</td>
        <td><code>ATRIUM_HISTORY_PEOPLE_DAYS</code></td></tr>
      <tr><th scope="row">Alerts</th><td>90 days in history; the newest in the inbox</td>
        <td><code>ATRIUM_HISTORY_ALERT_DAYS</code>, <code>ATRIUM_ALERTS_KEPT</code></td></tr>
      <tr><th scope="row">How many people were where</th><td>two years, by the minute</td>
        <td><code>ATRIUM_HISTORY_COUNT_DAYS</code></td></tr>
      <tr><th scope="row">Heat maps and visits</th>
        <td>never of fewer than five people in a cell, at a zone, on a way</td>
        <td>none: always so</td></tr>
    </tbody>
  </table></div>
  <p class="quiet">These are the defaults; what this site has set stands in each service's log at its start.</p>
</section>
"""
