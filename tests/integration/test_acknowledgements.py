"""That a service has nothing left of an erased device is told when it is so: not before, and once."""

from waiting import wait_until

from shared.acknowledgements import Acknowledgements
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import ErasureDone

DEVICE = "d-1"


def test_it_is_told_once_nothing_is_left_and_not_before(zenoh_router: str) -> None:
    keys, stored = Keys("hall"), {DEVICE}
    with Bus([zenoh_router], wait=10.0) as bus, Bus([zenoh_router], wait=10.0) as asker:
        inbox = asker.inbox()
        inbox.subscribe(keys.erased(), ErasureDone, cached=True)
        acknowledged = Acknowledgements(bus, keys, "history")
        acknowledged.await_gone(DEVICE, lambda: DEVICE not in stored)
        acknowledged.tell_gone()
        assert DEVICE not in acknowledged
        acknowledged.await_gone("d-2", lambda: True)
        acknowledged.tell_gone()
        assert ("d-2" in acknowledged, DEVICE in acknowledged) == (True, False)
        stored.clear()
        acknowledged.tell_gone()
        acknowledged.await_gone(DEVICE, lambda: True)
        acknowledged.tell_gone()
        told: list[str] = []

        def heard() -> bool:
            told.extend(each.message.device for each in inbox.receive(0.1) if isinstance(each.message, ErasureDone))
            return {DEVICE, "d-2"} <= set(told)

        wait_until(heard, 20, "the word of both")
    assert sorted(told) == [DEVICE, "d-2"]
