"""A token says whose it is and what it may do; nobody without a key can make or change one."""

import json
from base64 import urlsafe_b64decode, urlsafe_b64encode

import jwt
import pytest

from services.gateway.devices.tokens import Claims, TokenSigner, keys_of

OLD, NEW = "an old key of more than thirty-two characters", "a new key of more than thirty-two characters"


def test_a_token_says_whose_it_is_what_it_may_do_and_until_when() -> None:
    signer = TokenSigner([OLD])
    token = signer.sign("d-1", "t-1", ["post", "read"], 1000.7)
    assert signer.read(token, now=999.0) == Claims("t-1", "d-1", frozenset({"post", "read"}), 1000.0)
    assert signer.read(token, now=1000.0) is None


def test_keys_are_exchanged_without_voiding_tokens_and_a_dropped_key_voids_them() -> None:
    token = TokenSigner([OLD]).sign("d-1", "t-1", ["post"], 1000.0)
    both = TokenSigner(keys_of(f"{NEW}, {OLD}"))
    assert both.read(token, 0.0) is not None
    assert TokenSigner([NEW]).read(token, 0.0) is None
    assert TokenSigner([NEW]).read(both.sign("d-1", "t-1", ["post"], 1000.0), 0.0) is not None


def test_a_token_that_was_changed_signed_otherwise_or_is_none_at_all_is_not_read() -> None:
    signer = TokenSigner([OLD])
    token = signer.sign("d-1", "t-1", ["post"], 1000.0)
    head, body, signature = token.split(".")
    claims = json.loads(urlsafe_b64decode(body + "=="))
    other = urlsafe_b64encode(json.dumps(claims | {"sub": "d-2"}).encode()).decode().rstrip("=")
    kid = jwt.get_unverified_header(token)["kid"]
    unsigned = jwt.encode(claims, "", "none", headers={"kid": kid})
    longer = jwt.encode(claims, OLD, "HS512", headers={"kid": kid})
    no_scope = jwt.encode({"sub": "d-1", "jti": "t", "exp": 1000}, OLD, "HS256", headers={"kid": kid})
    odd = jwt.encode({"sub": "d-1", "jti": "t", "exp": "soon", "scope": []}, OLD, "HS256", headers={"kid": kid})
    for wrong in (f"{head}.{other}.{signature}", unsigned, longer, no_scope, odd, "", "a.b.c", "\x00", token[:-3], "é"):
        assert signer.read(wrong, 0.0) is None, wrong


@pytest.mark.parametrize("text", [f"{OLD},{NEW}", f" {OLD} , {NEW} ,"])
def test_several_keys_are_separated_by_commas(text: str) -> None:
    assert keys_of(text) == [OLD, NEW]
