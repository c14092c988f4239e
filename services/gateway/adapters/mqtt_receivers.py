"""Who brings what receivers publish over MQTT? A client that comes back when the broker does.

Quality of service 0 and a clean session: readings grow old quickly, none is waited for, and a retained one is none. The
client library keeps nothing in memory that has not been looked at here, and its own log stays off: topics bear the
addresses of strangers.
"""

from __future__ import annotations

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
    """

    def __init__(self, broker: Broker, topics: Sequence[str], take: Callable[[list[Heard], float], Any]) -> None:
        self._broker = broker
        self._topics = list(topics)
        self._take = take
        self._told = False
        client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
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
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = LARGEST
        self._client.connect_async(self._broker.host, self._broker.port, keepalive=30, properties=properties)
        self._client.loop_start()

    def stop(self) -> None:
        """Disconnect and wait for the thread."""
        self._client.disconnect()
        self._client.loop_stop()
        CONNECTED.set(0)

    def _on_connect(self, client: mqtt.Client, _data: Any, _flags: Any, reason: ReasonCode, _properties: Any) -> None:
        if reason.is_failure:
            ATTEMPTS.labels("refused").inc()
            if not self._told:
                log.error("the MQTT broker refuses the gateway", broker=self._broker.host, reason=str(reason))
            self._told = True
            return
        ATTEMPTS.labels("connected").inc()
        self._told = False
        CONNECTED.set(1)
        log.info("MQTT broker connected", broker=self._broker.host, topics=self._topics)
        client.subscribe([(topic, SubscribeOptions(qos=0, retainHandling=2)) for topic in self._topics])

    def _on_connect_fail(self, _client: Any, _data: Any) -> None:
        ATTEMPTS.labels("failed").inc()
        if not self._told:
            self._told = True
            broker = f"{self._broker.host}:{self._broker.port}"
            log.warning("MQTT broker not reached, or its certificate not trusted; trying again", broker=broker)

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, reason: ReasonCode, _properties: Any) -> None:
        CONNECTED.set(0)
        if reason.is_failure and not self._told:
            self._told = True
            log.warning("MQTT broker away; trying again", broker=self._broker.host, reason=str(reason))

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
