"""The page at ``/learning``: what the system learns, how well it fits, what it decided and why; and two buttons."""

from __future__ import annotations

from html import escape
from typing import Any

from nicegui import ui

from services.dashboard import learning_words as words
from services.dashboard.choice import Choice
from services.dashboard.learning_charts import path_loss_chart, score_chart, stride_chart
from services.dashboard.learning_client import LearningClient, LearningView, NoAnswer
from services.dashboard.page_header import header, page_visitor

__all__ = ["add_learning_page"]

EVERY = 3.0
"""Seconds between two looks."""
PICTURE_EVERY = 10
"""Looks between two of the same map."""
MAPS = {
    "visits": "Where people walk",
    "occlusion": "Where nobody walks",
    "radio": "Radio of one access point",
    "shadowing": "Shadowing of one access point",
    "magnetic": "Magnetic field",
}
OF_POINT = ("radio", "shadowing")


def add_learning_page(client: LearningClient, title: str, can_sign_out: bool, areas: dict[str, list[str]]) -> None:
    """Serve the page.

    Args:
        client: asks the API.
        title: name of the site.
        can_sign_out: whether people signed in.
        areas: by area, the ids of the access points on its floor.
    """

    @ui.page("/learning", title=f"Learning · {title} · Atrium", response_timeout=10.0)
    def learning() -> None:
        ui.add_head_html('<link rel="stylesheet" href="/static/dashboard.css">')
        ui.add_head_html('<link rel="stylesheet" href="/static/learning.css">')
        ui.add_body_html('<script type="module" src="/static/learning.js"></script>')
        ui.query(".nicegui-content").classes(replace="atrium-page learning-page")
        header(title, can_sign_out, here="learning")
        _Page(client.of(page_visitor()), areas)


class _Page:
    """One browser's page; everything stands from the beginning and is filled as answers come."""

    def __init__(self, client: LearningClient, areas: dict[str, list[str]]) -> None:
        self._client = client
        self._areas = areas
        self._html: dict[str, ui.html] = {}
        self._charts: dict[str, ui.echart] = {}
        self._shown: dict[str, Any] = {}
        self._looks = 0
        self._frozen = False
        with ui.element("main").classes("learning"):
            self._banner = ui.html("", sanitize=False).classes("learning-banner").props('role="alert"')
            self._now()
            self._section("accuracy", "How far off it believes to be", "Of named positions, from what it had not seen.")
            for area in areas:
                self._section(
                    f"radio-{area}", f"Access points of {area}", "How well the active model explains them.", 300
                )
            self._section("cameras", "Cameras", "How well the tracks of each are supported, over time.", 300)
            self._section("devices", "Phones", "Step length by cadence, each person's own.", 300)
            self._maps()
            self._history()
        ui.timer(EVERY, self._look)

    def _now(self) -> None:
        with ui.element("section").props('aria-labelledby="now-heading"'):
            ui.html('<h2 id="now-heading">What is going on</h2>', sanitize=False)
            self._slot("now")
            with ui.element("div").classes("orders") as self._orders:
                self._freeze = ui.button("Freeze", on_click=self._ask_freeze).props("no-caps outline")
                self._models = Choice("Model")
                self._back = ui.button("Roll back…", on_click=self._ask_back).props("no-caps outline")
            self._orders.set_visibility(False)

    def _section(self, name: str, heading: str, caption: str, chart: int = 0) -> None:
        with ui.element("section").props(f'aria-labelledby="{name}-heading"'):
            ui.html(
                f'<h2 id="{name}-heading">{escape(heading)} <span class="count">{escape(caption)}</span></h2>',
                sanitize=False,
            )
            if chart:
                self._charts[name] = ui.echart({}).classes("chart")
                self._charts[name].set_visibility(False)
            self._slot(name)

    def _slot(self, name: str) -> None:
        self._html[name] = ui.html('<p class="empty">Asking…</p>', sanitize=False).classes("slot")

    def _maps(self) -> None:
        with ui.element("section").props('aria-labelledby="maps-heading"'):
            ui.html('<h2 id="maps-heading">Maps</h2>', sanitize=False)
            with ui.element("div").classes("orders"):
                self._area = Choice("Area", self._choose_area)
                self._kind = Choice("Map", self._draw)
                self._point = Choice("Access point", self._draw)
                self._area.offer({area: area for area in self._areas})
                self._kind.offer(MAPS)
                self._area.show(len(self._areas) > 1)
            self._slot("map")
        self._fill_points()

    def _history(self) -> None:
        self._section("history", "Decisions", "What went live, what was refused and why; newest first.")

    async def _look(self) -> None:
        """Ask once and show what changed."""
        try:
            report = await self._client.report()
        except NoAnswer as reason:
            self._say(str(reason))
            return
        self._say("")
        self._show(report)
        if self._looks % PICTURE_EVERY == 0:
            await self._draw()
        self._looks += 1

    def _say(self, problem: str) -> None:
        shown = f"<p>{escape(problem)} Trying again…</p>" if problem else ""
        if self._shown.get("banner") != shown:
            self._shown["banner"] = shown
            self._banner.set_content(shown)

    def _show(self, report: LearningView) -> None:
        self._fill("now", words.summary(report))
        self._fill("accuracy", words.accuracy_table(report.areas))
        for area in report.areas:
            name = f"radio-{area.area}"
            if name in self._html:
                self._fill(name, words.access_points_table(area))
                self._plot(name, path_loss_chart(area.access_points) if area.access_points else None)
        self._fill("cameras", words.cameras_table(report.cameras))
        scored = [camera for camera in report.cameras if len(camera.score) > 1]  # one point is no course of time
        self._plot("cameras", score_chart(scored) if scored else None)
        self._fill("devices", words.devices_table(report.devices))
        walked = [device for device in report.devices if device.slope is not None]
        self._plot("devices", stride_chart(walked) if walked else None)
        self._fill("history", words.history_table(report.history))
        self._offer(report)

    def _offer(self, report: LearningView) -> None:
        self._orders.set_visibility(report.may_change)
        self._frozen = report.frozen
        self._freeze.set_text("Unfreeze…" if report.frozen else "Freeze…")
        live: dict[str, str] = {}
        for row in report.history:
            if row.decision != "refused":
                live.setdefault(f"{row.kind}/{row.subject}", words.model_name(row))
        self._models.offer(live)
        self._models.show(bool(live))
        self._back.set_visibility(bool(live))

    def _fill(self, name: str, content: str) -> None:
        if self._shown.get(name) != content:
            self._shown[name] = content
            self._html[name].set_content(content)

    def _plot(self, name: str, options: dict[str, Any] | None) -> None:
        chart, key = self._charts[name], f"{name} chart"
        if self._shown.get(key) == options and key in self._shown:
            return
        self._shown[key] = options
        chart.set_visibility(options is not None)
        if options is not None:
            chart.options.clear()
            chart.options.update(options)
            chart.update()

    def _fill_points(self) -> None:
        self._point.offer({point: point for point in self._areas.get(self._area.value or "", [])})

    async def _choose_area(self) -> None:
        self._fill_points()
        await self._draw()

    async def _draw(self) -> None:
        """Show the chosen map, or why there is none."""
        area, kind = self._area.value, self._kind.value
        self._point.show(kind in OF_POINT)
        if area is None or kind is None:
            return
        try:
            drawn = await self._client.picture(area, kind, self._point.value if kind in OF_POINT else None)
        except NoAnswer as reason:
            drawn = f'<p class="empty">{escape(str(reason))}</p>'
        self._fill("map", drawn)

    async def _ask_freeze(self) -> None:
        if self._frozen:
            await self._ask("What wins goes live again. Unfreeze?", "Unfreeze", "unfreeze")
        else:
            await self._ask(
                "Learning goes on, but nothing new goes live until somebody unfreezes it. Freeze?", "Freeze", "freeze"
            )

    async def _ask_back(self) -> None:
        kind, _, subject = str(self._models.value or "").partition("/")
        if subject:
            question = f"The {kind} model of {subject} returns to the version before. Roll back?"
            await self._ask(question, "Roll back", "rollback", {"kind": kind, "subject": subject})

    async def _ask(self, question: str, yes: str, what: str, body: dict[str, str] | None = None) -> None:
        with ui.dialog() as dialog, ui.card().classes("question"):
            ui.label(question)
            with ui.element("div").classes("orders"):
                ui.button("Cancel", on_click=lambda: dialog.submit(False)).props("no-caps flat autofocus")
                ui.button(yes, on_click=lambda: dialog.submit(True)).props("no-caps unelevated")
        sure = await dialog
        dialog.delete()
        if not sure:
            return
        try:
            ui.notify(await self._client.order(what, body), type="positive")
        except NoAnswer as reason:
            ui.notify(str(reason), type="negative")
        await self._look()
