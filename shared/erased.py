"""Whose consent was withdrawn: a bounded memory, so that nothing still under way brings a device back."""

from __future__ import annotations

import itertools
from collections import OrderedDict
from collections.abc import Sequence

import msgspec

from shared.messages import Alert, Revision, TrackFrame
from shared.zones import ZoneDefinition, ZoneRule

__all__ = ["Erased"]

KEPT = 100_000
"""Device ids are random and never given twice, so the oldest can be forgotten once nothing of theirs is under way."""


class Erased:
    """The devices that are nobody any more."""

    def __init__(self) -> None:
        self._devices: OrderedDict[str, None] = OrderedDict()

    def add(self, device: str) -> None:
        """Erase a device."""
        self._devices[device] = None
        if len(self._devices) > KEPT:
            self._devices.popitem(last=False)

    def __contains__(self, device: str) -> bool:
        """Whether the device was erased."""
        return device in self._devices

    def from_tracks(self, frame: TrackFrame) -> TrackFrame:
        """Return the frame without erased devices; the same frame where it names none.

        Whom a camera sees stays, without a name; who is followed by the device alone is gone with it.
        """
        named = itertools.chain(frame.device, frame.runner_up, *frame.sources)
        if not self._devices or not any(name in self._devices for name in named if name):
            return frame
        frame = self._without_unseen(frame)
        device = [None if name in self._devices else name for name in frame.device]
        return msgspec.structs.replace(
            frame,
            device=device,
            probability=[
                0.0 if now is None and was is not None else p
                for now, was, p in zip(device, frame.device, frame.probability, strict=True)
            ],
            runner_up=[None if name in self._devices else name for name in frame.runner_up],
            sources=[[name for name in names if name not in self._devices] for names in frame.sources],
        )

    def _without_unseen(self, frame: TrackFrame) -> TrackFrame:
        kept = [
            row
            for row, (name, state) in enumerate(zip(frame.device, frame.state, strict=True))
            if state != "unseen" or name not in self._devices
        ]
        if len(kept) == len(frame.track):
            return frame
        columns = {column: [getattr(frame, column)[row] for row in kept] for column in frame.columns()}
        return msgspec.structs.replace(frame, **columns)

    def from_revision(self, revision: Revision) -> Revision:
        """Return the revision without erased devices and all that was said of them."""
        if not any(name in self._devices for name in revision.device):
            return revision
        kept = [row for row, name in enumerate(revision.device) if name not in self._devices]
        number = {row: place for place, row in enumerate(kept)}
        points = [row for row, of in enumerate(revision.of) if of in number]
        columns = {column: [getattr(revision, column)[row] for row in points] for column in revision.columns()}
        columns["of"] = [number[of] for of in columns["of"]]
        columns.update({name: [getattr(revision, name)[row] for row in kept] for name in revision.event_columns()})
        return msgspec.structs.replace(revision, **columns)

    def from_alert(self, alert: Alert) -> Alert:
        """Return the alert without erased devices; the same alert where it names none."""
        gone = {name: None for name in ("device", "other_device") if getattr(alert, name) in self._devices}
        return msgspec.structs.replace(alert, **gone) if gone else alert

    def from_zones(self, zones: Sequence[ZoneDefinition]) -> list[ZoneDefinition]:
        """Return the zones without erased devices; a rule about nobody else goes with them."""
        return [
            msgspec.structs.replace(zone, rules=[kept for rule in zone.rules if (kept := self._from_rule(rule))])
            if any(name in self._devices for rule in zone.rules for name in (rule.target, *rule.devices))
            else zone
            for zone in zones
        ]

    def _from_rule(self, rule: ZoneRule) -> ZoneRule | None:
        devices = [name for name in rule.devices if name not in self._devices]
        # Without its devices a rule would be about everybody.
        about_nobody = rule.target in self._devices or (rule.devices and not devices)
        return None if about_nobody else msgspec.structs.replace(rule, devices=devices)
