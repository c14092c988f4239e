"""Who brings what receivers publish over MQTT? A client that comes back when the broker does, and says when it cannot.

Quality of service 0 and a clean session: readings grow old quickly, none is waited for, and a retained one is none. The
client library keeps nothing in memory that has not been looked at here, and its own log stays off: topics bear the
addresses of strangers.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import paho.mqtt.client as mqtt
import structlog
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions
from prometheus_client import Counter, Gauge

from services.gateway.adapters.adapter import ReceiverAdapter
from services.gateway.adapters.espresense import Espresense
from services.gateway.adapters.mqtt_broker import Broker
from services.gateway.adapters.theengs import Theengs
from services.gateway.errors import RequestError
from services.gateway.phones.heard import Heard

__all__ = ["MqttReceivers"]

MESSAGES = Counter("atrium_gateway_mqtt_messages_total", "Messages of receivers over MQTT", ["result"])
ATTEMPTS = Counter("atrium_gateway_mqtt_connections_total", "Attempts to connect to the MQTT broker", ["result"])
CONNECTED = Gauge("atrium_gateway_mqtt_connected", "1 while the MQTT broker is connected")
LARGEST = 65_536
"""Bytes; the broker is asked to send no larger packet."""
RETRY = (1, 15)
"""s: first and longest wait before the next attempt to connect."""
ADAPTERS: tuple[ReceiverAdapter, ...] = (Espresense(), Theengs())

log = structlog.get_logger(__name__)


class MqttReceivers:
    """Subscribes to the topics of receivers and hands on what they heard.

    Args:
        broker: where to connect.
        topics: what to subscribe to, wildcards allowed.
        take: called with readings and the server's clock at their arrival, in the client's thread.
        tell: called with what keeps readings away, and with None once nothing does.
    """

    def __init__(
        self,
        broker: Broker,
        topics: Sequence[str],
        take: Callable[[list[Heard], float], Any],
        tell: Callable[[str | None], None],
    ) -> None:
        self._broker = broker
        self._topics = list(topics)
        self._take = take
        self._tell = tell
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mqtt", daemon=True)
        client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        client.on_subscribe = self._on_subscribe
        client.reconnect_delay_set(*RETRY)
        if broker.user:
            client.username_pw_set(broker.user, broker.password or None)
        if broker.encrypted:
            client.tls_set(ca_certs=None if broker.authorities is None else str(broker.authorities))
        self._client = client

    def start(self) -> None:
        """Connect in a thread of its own; a broker that is not there yet is tried again.

        Raises:
            ValueError: the broker's host cannot be used at all.
        """
        self._connect()
        self._thread.start()

    def stop(self) -> None:
        """Disconnect and wait for the thread."""
        self._stopping.set()
        while self._thread.is_alive():
            self._client.disconnect()  # again: a client that is connecting just now overlooks it
            self._thread.join(0.5)
        CONNECTED.set(0)

    def _connect(self) -> None:
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = LARGEST
        self._client.connect_async(self._broker.host, self._broker.port, keepalive=30, properties=properties)

    def _run(self) -> None:
        """Let the client work until it is stopped; one that ends by itself is told of and begins anew."""
        while not self._stopping.is_set():
            reason = "it gave up"
            try:
                self._client.loop_forever(retry_first_connection=True)
            except Exception as error:
                reason = type(error).__name__
            if not self._stopping.is_set():
                CONNECTED.set(0)
                self._tell(f"the MQTT client has ended ({reason}); beginning anew")
                self._stopping.wait(RETRY[1])
                self._connect()

    def _on_connect(self, client: mqtt.Client, _data: Any, _flags: Any, reason: ReasonCode, _properties: Any) -> None:
        if reason.is_failure:
            ATTEMPTS.labels("refused").inc()
            self._tell(f"the MQTT broker {self._broker.host} refuses the gateway: {reason}")
            return
        ATTEMPTS.labels("connected").inc()
        CONNECTED.set(1)
        log.info("MQTT broker connected", broker=self._broker.host, topics=self._topics)
        client.subscribe([(topic, SubscribeOptions(qos=0, retainHandling=2)) for topic in self._topics])

    def _on_subscribe(self, _client: Any, _data: Any, _mid: Any, reasons: list[ReasonCode], _properties: Any) -> None:
        refused = [topic for topic, reason in zip(self._topics, reasons, strict=False) if reason.is_failure]
        if refused:
            self._tell(f"the MQTT broker {self._broker.host} does not let the gateway read {', '.join(refused)}")
        else:
            self._tell(None)

    def _on_connect_fail(self, _client: Any, _data: Any) -> None:
        ATTEMPTS.labels("failed").inc()
        broker = f"{self._broker.host}:{self._broker.port}"
        self._tell(f"the MQTT broker {broker} is not reached, or its certificate not trusted; trying again")

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: ReasonCode, _properties: Any) -> None:
        CONNECTED.set(0)
        if reason.is_failure:
            self._tell(f"the MQTT broker {self._broker.host} is away; trying again")

    def _on_message(self, _client: Any, _data: Any, message: mqtt.MQTTMessage) -> None:
        MESSAGES.labels(self._result(message)).inc()

    def _result(self, message: mqtt.MQTTMessage) -> str:
        """Take one message and return in a few fixed words what became of it."""
        if message.retain:
            return "retained"
        try:
            topic = message.topic
            for adapter in ADAPTERS:
                report = adapter.decode(topic, bytes(message.payload))
                if report is not None:
                    self._take(report.heard, time.time())
                    return "understood" if report.heard else "without a level"
        except (RequestError, UnicodeDecodeError):
            return "not understood"
        except Exception as error:  # what a stranger publishes must not end the client's thread
            log.error("a message of a receiver could not be taken", error=type(error).__name__)
            return "failed"
        return "other topic"
