"""What property tests ask of a refusal: a status of 4xx and a field."""

from collections.abc import Iterator
from contextlib import contextmanager

from services.gateway.errors import RequestError


@contextmanager
def refusals_name_a_field() -> Iterator[None]:
    """Let the block be refused, but only in a way that tells its sender what to mend."""
    refused = None
    try:
        yield
    except RequestError as error:
        refused = error
    if refused is not None:
        assert refused.status in (400, 422)
        assert refused.reply.detail[0].field
