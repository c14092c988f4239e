"""Keys: whatever may be named may stand in a key, and nothing else."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from shared.keys import Keys, is_identifier
from shared.truth import truth_key

identifiers = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)
BUILDERS = ["detections", "camera_status", "radio", "motion", "tracks", "chunks", "fusion_state", "alert"]


@given(identifiers, identifiers, st.sampled_from(BUILDERS))
def test_a_wildcard_finds_exactly_the_keys_of_its_kind(site: str, part: str, builder: str) -> None:
    keys = Keys(site)
    everything, one = zenoh.KeyExpr(getattr(keys, builder)()), zenoh.KeyExpr(getattr(keys, builder)(part))
    assert everything.includes(one)
    for other in set(BUILDERS) - {builder}:
        assert not zenoh.KeyExpr(getattr(keys, other)()).intersects(one)


@given(identifiers, identifiers, identifiers)
def test_sites_do_not_hear_each_other(one: str, other: str, camera: str) -> None:
    if one != other:
        mine = zenoh.KeyExpr(Keys(one).detections())
        assert not mine.intersects(zenoh.KeyExpr(Keys(other).detections(camera)))


@given(identifiers, identifiers)
def test_a_service_is_found_among_the_living(service: str, instance: str) -> None:
    keys = Keys("hall")
    assert zenoh.KeyExpr(keys.alive()).includes(zenoh.KeyExpr(keys.alive(service, instance)))


@pytest.mark.parametrize(
    "bad", ["", " ", "a b", "a/b", "**", "a*", "$*", "?", "#", "ü", "-a", ".a", "_a", "a" * 65, "a\n", "@", "a,b"]
)
def test_a_part_that_no_key_may_hold_is_refused_and_named(bad: str) -> None:
    assert not is_identifier(bad)
    with pytest.raises(ValueError, match="cannot be part of a key") as refusal:
        Keys("hall").detections(bad)
    assert repr(bad) in str(refusal.value)
    with pytest.raises(ValueError, match="cannot be part of a key"):
        Keys(bad)


@given(st.text(max_size=70))
def test_any_text_either_is_an_identifier_or_is_refused(text: str) -> None:
    if is_identifier(text) or text == "*":
        zenoh.KeyExpr(Keys("hall").alert(text))
    else:
        with pytest.raises(ValueError, match="cannot be part of a key"):
            Keys("hall").alert(text)


def test_the_schema_version_stands_in_every_key() -> None:
    assert truth_key(Keys("hall")) == "atrium/1/hall/truth"
