"""Older versions are left out, and the log tells of them once."""

from structlog.testing import capture_logs

from services.camera.learned_version import LearnedVersion


def test_what_is_older_is_left_out_and_told_once() -> None:
    version = LearnedVersion("alignment")
    assert not version.is_newer_than(1)  # nothing is known yet
    version.use(7)
    with capture_logs() as told:
        assert [version.is_newer_than(one) for one in (1, 6, 7, 2, 8)] == [True, True, False, True, False]
    assert [(line["what"], line["version"], line["used"]) for line in told] == [("alignment", 1, 7)]
    version.use(8)
    with capture_logs() as told:
        assert version.is_newer_than(7)
    assert len(told) == 1
