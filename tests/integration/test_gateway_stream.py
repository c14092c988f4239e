"""The same batches over a WebSocket: one answer to each frame, the same rules, an end with a reason."""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from gateway_process import Listener, Phone, Running, running_gateway
from waiting import wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    settings = {"ATRIUM_BATCH_BURST": "30", "ATRIUM_BATCHES_PER_SECOND": "0.5", "ATRIUM_BATCH_BYTES": "100000"}
    with running_gateway(tmp_path_factory.mktemp("gateway"), **settings) as running:
        yield running


@pytest.fixture(scope="module")
def listener(gateway: Running) -> Iterator[Listener]:
    listening = Listener(gateway.endpoint)
    yield listening
    listening.bus.close()


def address(phone: Phone) -> str:
    return f"ws://127.0.0.1:{phone.http.base_url.port}{phone.enrolled['stream']}"


def opened(phone: Phone) -> ClientConnection:
    return connect(address(phone), additional_headers=phone.headers)


def ask(stream: ClientConnection, frame: Any) -> dict[str, Any]:
    stream.send(frame if isinstance(frame, str | bytes) else json.dumps(frame))
    answer: dict[str, Any] = json.loads(stream.recv(10.0))
    return answer


def test_batches_of_a_stream_reach_the_bus_and_share_their_numbers_with_posts(
    gateway: Running, listener: Listener
) -> None:
    phone = Phone(gateway)
    with opened(phone) as stream:
        assert ask(stream, phone.batch(0))["accepted"] == {"samples": 50, "scans": 1, "readings": 2}
        assert ask(stream, json.dumps(phone.batch(1)).encode())["duplicate"] is False  # a binary frame
        assert ask(stream, phone.batch(1))["duplicate"] is True
    assert phone.post(phone.batch(1)).json()["duplicate"] is True
    assert phone.post(phone.batch(2)).json()["duplicate"] is False
    wait_until(lambda: len(listener.heard(phone.device)[0]) == 3, 10, "three scans")


def test_a_wrong_frame_is_answered_in_the_form_of_errors_and_the_stream_goes_on(gateway: Running) -> None:
    phone = Phone(gateway)
    with opened(phone) as stream:
        for frame, status, field in (
            ("{", 400, "body"),
            (b"\xff\xfe", 400, "body"),
            ({"seq": 0}, 422, "sent"),
            (phone.batch(0) | {"radio": [{"t": 5.0}]}, 422, "radio[0].t"),
        ):
            answer = ask(stream, frame)
            assert (answer["status"], answer["detail"][0]["field"]) == (status, field), answer
        assert ask(stream, phone.batch(0))["seq"] == 0


def test_what_is_sent_ahead_is_answered_in_order(gateway: Running) -> None:
    phone = Phone(gateway)
    with opened(phone) as stream:
        for seq in range(20):
            stream.send(json.dumps(phone.batch(seq)))
        assert [json.loads(stream.recv(10.0))["seq"] for _ in range(20)] == list(range(20))


def test_the_ration_of_a_device_holds_for_its_stream(gateway: Running) -> None:
    phone = Phone(gateway)
    now = time.time()
    with opened(phone) as stream:
        for seq in range(30):
            ask(stream, {"sent": now, "seq": seq, "radio": [{"t": now}]})
        answer = ask(stream, {"sent": now, "seq": 30, "radio": [{"t": now}]})
        assert answer["status"] == 429
        assert 1 <= answer["retry_after"] <= 2


def test_a_frame_beyond_the_limit_ends_the_stream(gateway: Running) -> None:
    phone = Phone(gateway)
    with opened(phone) as stream:
        stream.send("x" * 100_001)
        with pytest.raises(ConnectionClosed) as caught:
            stream.recv(10.0)
    assert caught.value.rcvd is not None
    assert caught.value.rcvd.code == 1009


def test_the_token_may_come_as_header_query_or_subprotocol(gateway: Running) -> None:
    phone = Phone(gateway)
    token = phone.enrolled["token"]
    with connect(f"{address(phone)}?token={token}") as stream:
        assert ask(stream, phone.batch(0))["seq"] == 0
    with connect(address(phone), subprotocols=[Subprotocol("atrium"), Subprotocol(token)]) as stream:
        assert stream.subprotocol == "atrium"
        assert ask(stream, phone.batch(1))["seq"] == 1


def test_a_stream_without_a_fitting_token_is_refused_with_the_reason(gateway: Running) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    answer = phone.http.post(f"/v1/devices/{phone.device}/tokens", json={"scopes": ["read"]}, headers=phone.headers)
    reading = {"Authorization": f"Bearer {answer.json()['token']}"}
    for headers, status in (({}, 401), ({"Authorization": "Bearer x"}, 401), (other.headers, 403), (reading, 403)):
        with pytest.raises(InvalidStatus) as caught:
            connect(address(phone), additional_headers=headers)
        assert caught.value.response.status_code == status
        assert json.loads(caught.value.response.body or b"")["status"] == status


def test_a_device_opens_few_streams_at_once(gateway: Running) -> None:
    phone = Phone(gateway)
    with ExitStack() as open_ones:
        first = open_ones.enter_context(opened(phone))
        for _ in range(3):
            open_ones.enter_context(opened(phone))
        with pytest.raises(InvalidStatus) as caught, opened(phone):
            pass
        assert caught.value.response.status_code == 429
        first.close()

        def again() -> bool:
            try:
                open_ones.enter_context(opened(phone))
            except InvalidStatus:
                return False
            return True

        wait_until(again, 20, "a place to come free")


def test_revoking_the_token_or_the_consent_ends_the_streams_it_opened_with_a_reason(gateway: Running) -> None:
    phone = Phone(gateway)
    path = f"/v1/devices/{phone.device}"
    made = phone.http.post(f"{path}/tokens", json={"scopes": ["post"]}, headers=phone.headers).json()
    narrow = connect(address(phone), additional_headers={"Authorization": f"Bearer {made['token']}"})
    with narrow, opened(phone) as stream:
        ask(narrow, phone.batch(0))
        assert phone.http.delete(f"{path}/tokens/{made['id']}", headers=phone.headers).status_code == 204
        with pytest.raises(ConnectionClosed) as caught:
            narrow.recv(10.0)
        assert caught.value.rcvd is not None
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (4401, "the token was revoked")
        assert ask(stream, phone.batch(1))["seq"] == 1
        assert phone.http.delete(path, headers=phone.headers).status_code == 204
        with pytest.raises(ConnectionClosed) as caught:
            stream.recv(10.0)
        assert caught.value.rcvd is not None
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (4401, "the consent was withdrawn")
