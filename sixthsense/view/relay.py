"""A relay of Rerun's page for browsers with a policy that blocks requests to other machines.

The page itself sends usage statistics and checks for updates. With the Content-Security-Policy the browser blocks every
request except those to this server and to the stream.
"""

from __future__ import annotations

import http.client
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6
from urllib.parse import quote, urlsplit

from sixthsense.view.hosts import hosts_of

_OWN = "'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:"
_KEPT = ("Content-Type", "Content-Encoding", "Content-Length", "Cache-Control", "ETag")
_TIMEOUT_S = 60.0


class Relay:
    """A server that relays another server on this machine, with the policy."""

    def __init__(self, address: str, page: str, stream_port: int) -> None:
        """Listen on `address` and relay `page`, http://...; the policy allows requests to it and to the stream alone.

        The host of the stream is the one under which the browser has reached this server. Requests for any other host
        are refused: a name of someone else that leads here is no page of this machine.
        """
        hosts, origin = hosts_of(address), urlsplit(page)

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                host = _host(self.headers["Host"])
                if host not in hosts:
                    self.send_error(421, f"allowed hosts: {', '.join(hosts)}")
                    return
                stream = f"http://{host}:{stream_port}"
                path = urlsplit(self.path)
                if path.path == "/" and "url=" not in path.query:
                    self.send_response(302)
                    self.send_header("Location", f"/?url={quote(f'rerun+{stream}/proxy', safe='')}")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                connection = http.client.HTTPConnection(str(origin.hostname), origin.port, timeout=_TIMEOUT_S)
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
                self.send_header("Content-Security-Policy", f"default-src {_OWN}; connect-src {_OWN} {stream}")
                self.send_header("Referrer-Policy", "no-referrer")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Log nothing: the terminal belongs to the run."""

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            address_family = AF_INET6 if ":" in address else AF_INET

            def handle_error(self, *_: object) -> None:
                """Ignore the error of a closed browser."""

        self._server = Server((address, 0), Handler)
        self.port = int(self._server.server_address[1])
        """port of the relay"""
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _host(header: str | None) -> str:
    """The host of a Host header without its port, as `hosts_of` writes it; empty for none and for a damaged one."""
    try:
        host = urlsplit(f"//{header or ''}").hostname or ""
    except ValueError:
        return ""
    return f"[{host}]" if ":" in host else host.lower()
