"""A browser's own list to choose from, which every keyboard, screen reader and phone knows how to handle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

__all__ = ["Choice"]


class Choice:
    """A labelled ``<select>``.

    Args:
        label: what is chosen.
        told: called after somebody chose.
    """

    def __init__(self, label: str, told: Callable[[], Any] | None = None) -> None:
        self.value: str | None = None
        self._told = told
        self._options: dict[str, str] = {}
        with ui.element("label").classes("choice") as self._whole:
            ui.html(f"<span>{label}</span>", sanitize=False)
            self._select = ui.element("select")
            self._select.on("change", self._chosen, js_handler="(event) => emit(event.target.value)")

    def offer(self, options: Mapping[str, str]) -> None:
        """Offer these, value by text; what is chosen stays chosen while it is among them."""
        if options == self._options:
            return
        self._options = dict(options)
        if self.value not in options:
            self.value = next(iter(options), None)
        self._select.clear()
        with self._select:
            for value, text in options.items():
                option = ui.element("option")
                option.props["value"] = value
                option.props["innerText"] = text
        self._select.props["value"] = self.value
        self._select.update()

    def show(self, visible: bool) -> None:
        """Show or hide it, label and all."""
        self._whole.set_visibility(visible)

    async def _chosen(self, event: GenericEventArguments) -> None:
        if event.args not in self._options:
            return
        self.value = event.args
        self._select.props["value"] = self.value
        if self._told is not None:
            await self._told()
