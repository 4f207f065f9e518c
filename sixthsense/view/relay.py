"""Rerun's page for browsers, handed on with a policy that keeps it from asking anything of other machines.

The page by itself reports usage to its makers, and asks for news of itself. A Content-Security-Policy lets the browser
refuse whatever is not asked of this server or of the stream.
"""

from __future__ import annotations

import http.client
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6
from urllib.parse import urlsplit

_OWN = "'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:"
_KEPT = ("Content-Type", "Content-Encoding", "Content-Length", "Cache-Control", "ETag")
_TIMEOUT_S = 60.0


class Relay:
    """Serves what another server on this machine serves, under the policy."""

    def __init__(self, address: str, page: str, stream: str) -> None:
        """Listen on `address` and hand on `page`, http://...; of others it may ask `stream`, http://..., alone."""
        policy = f"default-src {_OWN}; connect-src {_OWN} {stream}"
        behind = urlsplit(page)

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                connection = http.client.HTTPConnection(str(behind.hostname), behind.port, timeout=_TIMEOUT_S)
                try:
                    asked = {name: self.headers[name] for name in ("Accept-Encoding",) if name in self.headers}
                    connection.request("GET", self.path, headers=asked)
                    answer = connection.getresponse()
                    body = answer.read()
                except (OSError, http.client.HTTPException):
                    self.send_error(502)
                    return
                finally:
                    connection.close()
                self.send_response(answer.status)
                kept = {name: value for name in _KEPT if (value := answer.headers[name]) is not None}
                for name, value in (kept | {"Content-Length": str(len(body))}).items():
                    self.send_header(name, value)
                self.send_header("Content-Security-Policy", policy)
                self.send_header("Referrer-Policy", "no-referrer")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Nothing: the terminal is the run's."""

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            address_family = AF_INET6 if ":" in address else AF_INET

            def handle_error(self, *_: object) -> None:
                """Nothing: a browser that has gone is none of the run's business."""

        self._server = Server((address, 0), Handler)
        self.port = int(self._server.server_address[1])
        """that it listens on"""
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
