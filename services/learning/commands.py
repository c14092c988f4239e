"""What an operator orders, carried out and answered in plain words."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from services.learning.activation.bundle import BundleError, Renaming, pack, unpack
from services.learning.activation.consent import KEPT_DAYS, told_of_since
from services.learning.activation.kinds import PERSONAL
from services.learning.activation.questions import is_tried
from services.learning.activation.rows import StoredModel
from services.learning.activation.store import NoSuchModelError, NothingBeforeError, UnusableModelError
from services.learning.loop import LearningLoop
from shared.learning_command import LearningAnswer, LearningCommand, ModelLine
from shared.site import Site

__all__ = ["Commands"]

ALLOWED = f"of phones whose owners withdrew no consent, exported in the last {KEPT_DAYS} days"
_decoder = msgspec.json.Decoder(LearningCommand)


class _RefusedError(ValueError):
    """An order is not carried out; ``field`` of it is to blame, None: how things are."""

    def __init__(self, words: str, field: str | None, *, unknown: bool = False) -> None:
        super().__init__(words)
        self.answer = LearningAnswer(done=False, words=words, field=field, unknown=unknown)


class Commands:
    """Carries out orders; in the loop's thread.

    Args:
        loop: what is ordered about.
        site: whose models.
    """

    def __init__(self, loop: LearningLoop, site: Site) -> None:
        self._loop = loop
        self._site = site

    def answer(self, payload: bytes, now: float) -> bytes:
        """Return the answer to an order in JSON, once it is carried out or refused."""
        try:
            answer = self._carry_out(_decoder.decode(payload), now)
        except msgspec.DecodeError as error:
            answer = LearningAnswer(done=False, words=f"not understood: {error}")
        except _RefusedError as error:
            answer = error.answer
        return msgspec.json.encode(answer)

    def _carry_out(self, command: LearningCommand, now: float) -> LearningAnswer:
        store = self._loop.store
        match command.do:
            case "list":
                return self._list(store.models())
            case "freeze" | "unfreeze":
                frozen = command.do == "freeze"
                store.freeze(frozen)
                off = (
                    "nothing new goes live any more until it is unfrozen; candidates are tried and told of all the "
                    "same, and what proves worse than the model before still goes back"
                )
                return LearningAnswer(done=True, words=off if frozen else "models that win go live again")
            case "export":
                return self._export(command, now)
            case "import":
                return self._import(command, now)
            case "rollback" | "activate":
                return self._switch(command, now)
            case "map":
                return self._map(command)
            case "history":
                of = command.kind, command.subject, command.before, command.most
                page, older = store.decisions(*of, personal=command.personal)
                return LearningAnswer(done=True, history=page, older=older)

    def _export(self, command: LearningCommand, now: float) -> LearningAnswer:
        live = self._loop.store.all_active()
        left = 0 if command.personal else sum(one.kind in PERSONAL for one in live)
        words = f"{len(live) - left} models that are live"
        if left:
            words += f" ({left} more of people's phones are left out)"
        document = pack(live, self._site.site, now, personal=command.personal)
        return LearningAnswer(done=True, words=words, bundle=msgspec.Raw(document))

    def _list(self, models: Sequence[StoredModel]) -> LearningAnswer:
        lines = [
            ModelLine(
                kind=one.kind,
                subject=one.subject,
                version=one.version,
                state=one.state,
                t=one.decided,
                probation=one.probation,
                reason=one.reason,
            )
            for one in models
        ]
        frozen = "; activation is frozen" if self._loop.store.frozen else ""
        live = sum(one.state == "active" for one in models)
        return LearningAnswer(done=True, words=f"{len(models)} models, {live} of them live{frozen}", models=lines)

    def _switch(self, command: LearningCommand, now: float) -> LearningAnswer:
        if command.kind is None:
            raise _RefusedError("kind: is missing; allowed: radio, detector, stride, heading, alignment", "kind")
        if command.subject is None:
            raise _RefusedError("subject: is missing; allowed: an area, a camera or a device", "subject")
        who = f" ({command.by})" if command.by else ""
        try:
            if command.do == "rollback":
                model = self._loop.decisions.roll_back(command.kind, command.subject, now, f"ordered by hand{who}")
                words = f"{command.kind} of {command.subject} is back at what it was, now version {model.version}"
            else:
                model = self._by_hand(command, now, who)
                words = f"{command.kind} of {command.subject} is live as version {model.version}, untried"
        except UnusableModelError as error:
            raise _RefusedError(f"version: found one that nobody could use: {error}", "version") from error
        except NothingBeforeError as error:
            raise _RefusedError(str(error), None) from error
        except NoSuchModelError as error:
            field = str(error).partition(":")[0]
            raise _RefusedError(str(error), field, unknown=True) from error
        return LearningAnswer(done=True, words=words, version=model.version)

    def _by_hand(self, command: LearningCommand, now: float, who: str) -> StoredModel:
        if command.kind is None or command.subject is None or command.version is None:
            raise _RefusedError("version: is missing; allowed: one that `list` tells", "version")
        stored = self._loop.store.get(command.kind, command.subject, command.version)
        if stored.state == "active":
            raise _RefusedError(f"version: {stored.version} is live already; allowed: another one", "version")
        return self._loop.decisions.put_live(stored, now, f"activated by hand, untried{who}")

    def _import(self, command: LearningCommand, now: float) -> LearningAnswer:
        names = Renaming(command.as_site, command.areas, command.cameras)
        try:
            incoming = unpack(bytes(command.bundle), self._site, names)
        except BundleError as error:
            raise _RefusedError(str(error), error.field) from error
        everything = len(incoming)
        old = not told_of_since(bytes(command.bundle), now)
        incoming = [
            one for one in incoming if one.kind not in PERSONAL or not (old or self._loop.has_forgotten(one.subject))
        ]
        why = f"exported over {KEPT_DAYS} days ago" if old else "the phones' owners withdrew consent"
        if not incoming:
            raise _RefusedError(f"bundle.models: found phones' alone: {why}; allowed: {ALLOWED}", "bundle")
        who = f" ({command.by})" if command.by else ""
        taken = self._loop.decisions.take_in(incoming, now, who, live=command.force)
        without = everything - len(incoming)
        left = f"; {without} of phones left out: {why}" if without else ""
        return LearningAnswer(done=True, words=f"{len(taken)} models taken in, {_fate(taken, command.force)}{left}")

    def _map(self, command: LearningCommand) -> LearningAnswer:
        known = list(self._loop.lessons.areas)
        if command.area not in known:
            words = f"area: found {command.area!r}; allowed: {', '.join(known)}"
            raise _RefusedError(words, "area", unknown=command.area is not None)
        answer = self._loop.lessons.map(command)
        if answer is not None:
            return answer
        return LearningAnswer(done=True, words="no such map is learned here yet")


def _fate(taken: Sequence[StoredModel], force: bool) -> str:
    """Return in words what becomes of models that were taken in."""
    if force:
        return f"live now, untried: {_named(taken)}"
    tried = [one for one in taken if is_tried(one.kind)]
    waiting = [one for one in taken if not is_tried(one.kind)]
    fates = []
    if tried:
        fates.append(f"live once they win against what is (`atrium models list`): {_named(tried)}")
    if waiting:
        fates.append(f"never tried and live once you say so (`atrium models activate`): {_named(waiting)}")
    return "; ".join(fates)


def _named(models: Sequence[StoredModel]) -> str:
    return ", ".join(f"{one.kind} of {one.subject}" for one in models)
