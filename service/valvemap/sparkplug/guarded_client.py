"""Paho's client behind the packet guard."""

from typing import Any

from paho.mqtt.client import Client

from valvemap.sparkplug.packet_guard import PacketGuard, PacketRefused


class GuardedClient(Client):
    """An MQTT client that checks packet headers before the body, in both directions."""

    def __init__(self, guard: PacketGuard, *arguments: Any, **more: Any) -> None:  # noqa: ANN401
        super().__init__(*arguments, **more)
        self._guard = guard

    def _sock_recv(self, bufsize: int) -> bytes:
        data = super()._sock_recv(bufsize)
        try:
            self._guard.receive(data)
        except PacketRefused as refusal:
            raise ConnectionAbortedError(str(refusal)) from refusal  # paho closes the connection
        return data

    def _sock_send(self, buf: bytes | bytearray) -> int:
        sent = super()._sock_send(buf)
        self._guard.send(bytes(buf[:sent]))
        return sent
