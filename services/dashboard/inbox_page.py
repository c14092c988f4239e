"""The page at ``/alerts``: what happened, and who has looked at it. Its life is ``static/inbox.js``."""

from __future__ import annotations

from services.dashboard.module_page import add_module_page

__all__ = ["add_inbox_page"]


def add_inbox_page(title: str, can_sign_out: bool) -> None:
    """Serve the page."""
    add_module_page("/alerts", "inbox", "Alerts", _BODY, title, can_sign_out)


_BODY = """
<section class="card inbox" aria-labelledby="inbox-heading">
  <h2 id="inbox-heading">Alerts <span id="inbox-count" class="count" role="status"></span></h2>
  <div class="controls">
    <label>Show <select id="inbox-state">
      <option value="open">not acknowledged</option>
      <option value="done">acknowledged</option>
      <option value="all">all</option>
    </select></label>
    <label>What <select id="inbox-kind"><option value="">everything</option></select></label>
    <label>Where <select id="inbox-zone"><option value="">everywhere</option></select></label>
    <label>Phone <input id="inbox-device" type="search" list="inbox-devices" maxlength="64" autocomplete="off"
      placeholder="anybody" title="A phone's id, or the end of one that is listed"></label>
    <datalist id="inbox-devices"></datalist>
    <label>Since <select id="inbox-since">
      <option value="">ever</option>
      <option value="3600">the last hour</option>
      <option value="86400">the last day</option>
      <option value="604800">the last week</option>
    </select></label>
    <button type="button" id="inbox-all" hidden></button>
  </div>
  <p id="inbox-said" class="quiet" role="status"></p>
  <p id="inbox-lacking" class="hint" hidden></p>
  <p id="inbox-problem" class="problem" role="alert" hidden></p>
  <ul id="inbox-rows" class="alerts" data-empty="Nothing of that kind."
    aria-live="polite" aria-relevant="additions"></ul>
  <div class="orders"><button type="button" id="inbox-more" hidden>Older alerts</button></div>
</section>
<dialog id="inbox-ask" class="ask"></dialog>
"""
