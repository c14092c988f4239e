"""Phones reach a gateway by HTTPS; without it, it does not open to the network outside the demo."""

import asyncio
import json
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from certificates import make_certificate
from gateway_process import Phone, Running, running_gateway
from pydantic import ValidationError
from websockets.asyncio.client import connect

from services.gateway.settings import GatewaySettings
from shared.http_server import Tls, serve
from shared.runner import ServiceError
from shared.settings import SettingsError, read_settings


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificate(tmp_path_factory.mktemp("certificate"))


@pytest.fixture(scope="module")
def gateway(certificate: Path) -> Iterator[Running]:
    settings = {
        "ATRIUM_TLS_CERTIFICATE": str(certificate),
        "ATRIUM_TLS_KEY": str(certificate.with_name("key.pem")),
    }
    with running_gateway(certificate.parent, **settings) as running:
        address = f"https://127.0.0.1:{running.http.base_url.port}"
        trusting = ssl.create_default_context(cafile=str(certificate))
        with httpx.Client(base_url=address, verify=trusting, timeout=10.0) as client:
            running.http = client
            yield running


def test_a_phone_enrols_posts_and_streams_over_a_certificate_it_verifies(gateway: Running, certificate: Path) -> None:
    phone = Phone(gateway)
    assert phone.post(phone.batch(0)).status_code == 200
    trusting = ssl.create_default_context(cafile=str(certificate))
    address = f"wss://127.0.0.1:{gateway.http.base_url.port}{phone.enrolled['stream']}"

    # Not the client with a thread that reads: CPython before 3.13 does not guard TLS against one that writes meanwhile.
    async def streamed() -> str | bytes:
        async with connect(address, ssl=trusting, additional_headers=phone.headers, proxy=None) as stream:
            await stream.send(json.dumps(phone.batch(1)))
            return await asyncio.wait_for(stream.recv(), 10.0)

    assert json.loads(asyncio.run(streamed()))["seq"] == 1


def test_nobody_is_answered_in_plain_text_or_with_a_certificate_not_trusted(gateway: Running) -> None:
    port = gateway.http.base_url.port
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"http://127.0.0.1:{port}/v1/consent")
    with pytest.raises(httpx.ConnectError, match="certificate"):
        httpx.get(f"https://127.0.0.1:{port}/v1/consent")


def settings(**values: object) -> GatewaySettings:
    return GatewaySettings.model_validate({"site_file": "site.yaml", **values})


def test_outside_the_demo_plain_http_stays_on_this_machine() -> None:
    with pytest.raises(ValidationError, match=r"gateway_host: 0\.0\.0\.0 is open to the network"):
        settings(gateway_host="0.0.0.0")
    with pytest.raises(ValidationError, match=r"museum\.example is open to the network"):
        settings(gateway_host="museum.example")
    for allowed in (
        {},
        {"gateway_host": "::1"},
        {"gateway_host": "localhost"},
        {"gateway_host": "0.0.0.0", "profile": "demo"},
        {"gateway_host": "0.0.0.0", "behind_proxy": True, "gateway_public_url": "https://museum.example"},
        {"staff_key": "", "receiver_key": "", "mqtt_url": ""},
        {"gateway_host": "0.0.0.0", "tls_certificate": "a.pem", "tls_key": "b.pem"},
    ):
        settings(**allowed)
    for url in ("", "http://museum.example"):
        with pytest.raises(ValidationError, match="gateway_public_url"):
            settings(behind_proxy=True, gateway_public_url=url)
    with pytest.raises(ValidationError, match="proxy_addresses"):
        settings(proxy_addresses=["the proxy"])
    with pytest.raises(ValidationError, match="both are needed"):
        settings(tls_certificate="a.pem", tls_key="")


@pytest.mark.parametrize("name", ["enrolment_key", "token_key", "address_key"])
def test_outside_the_demo_no_secret_keeps_its_default(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATRIUM_SITE_FILE", "site.yaml")
    for secret in {"enrolment_key", "token_key", "address_key"} - {name}:
        monkeypatch.setenv(f"ATRIUM_{secret.upper()}", f"a secret of this museum for {secret}")
    with pytest.raises(SettingsError, match=f"{name}: the default secret is for the demo only"):
        read_settings(GatewaySettings, [])
    assert read_settings(GatewaySettings, ["--profile", "demo"]).profile == "demo"


def test_token_keys_are_long_and_the_demos_is_none_of_several_outside_the_demo() -> None:
    demo = GatewaySettings.model_fields["token_key"].default.get_secret_value()
    for text in ("short", "", ",", f"{'x' * 32},short"):
        with pytest.raises(ValidationError, match="32 characters"):
            settings(token_key=text)
    with pytest.raises(ValidationError, match="the demo's key"):
        settings(token_key=f"{'x' * 32},{demo}")
    settings(token_key=f"{'x' * 32},{demo}", profile="demo")


def test_a_certificate_that_cannot_be_used_is_named(tmp_path: Path, certificate: Path) -> None:
    key = certificate.with_name("key.pem")
    broken = tmp_path / "broken.pem"
    broken.write_text("no certificate", encoding="utf-8")
    for tls, text in (
        (Tls(tmp_path / "missing.pem", key), "missing.pem: cannot be read: No such file"),
        (Tls(broken, key), "no certificate with its key in PEM form"),
        (Tls(certificate, broken), "no certificate with its key in PEM form"),
    ):
        with pytest.raises(ServiceError, match=text):
            serve(None, "127.0.0.1", 0, threading.Event(), tls=tls)
