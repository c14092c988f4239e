"""A tiny network camera: MJPEG over HTTP, which can die and come back on the same port."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


class MjpegServer:
    """Serves ``picture(n)`` at ``rate`` pictures per second to everybody who asks, until closed."""

    def __init__(self, port: int, picture: Callable[[int], NDArray[np.uint8]], rate: float = 25.0) -> None:
        self.url = f"http://127.0.0.1:{port}/stream.mjpeg"
        self._closing = threading.Event()
        closing = self._closing
        self._open: list[socket.socket] = []
        connections = self._open

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                connections.append(self.connection)
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                number = 0
                while not closing.wait(1.0 / rate):
                    body = cv2.imencode(".jpg", picture(number))[1].tobytes()
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(body)}\r\n\r\n"
                    try:
                        self.wfile.write(head.encode() + body + b"\r\n")
                    except OSError:
                        return
                    number += 1

            def log_message(self, *_: Any) -> None:
                """Be quiet."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        """Die at once, connections included."""
        self._closing.set()
        self._server.shutdown()
        self._server.server_close()
        for connection in self._open:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
