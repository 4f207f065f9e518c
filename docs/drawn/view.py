"""view.png: the live view in a browser after a run. Needs the extra view, chromium and websocket-client."""

from __future__ import annotations

import base64
import json
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

COMMAND = [str(Path(sys.executable).with_name("sixthsense")), "run", "apartment", "--view", "browser", "--overwrite"]
BROWSER = [
    "chromium", "--headless=new", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync",
    "--disable-component-update", "--disable-quic", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--hide-scrollbars", "--window-size=1600,1000", "--remote-debugging-port=9333", "--remote-allow-origins=*",
]  # fmt: skip
DRAWN_S = 90.0
"""until the page has drawn the run, on a slow machine without a graphics card"""


def ask(socket: Any, method: str, **parameters: Any) -> dict[str, Any]:
    """One answer of the browser's debugging protocol."""
    socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))
    while True:
        answer: dict[str, Any] = json.loads(socket.recv())
        if answer.get("id") == 1:
            return answer["result"]


def main() -> None:
    import websocket

    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.Popen(
            [*COMMAND, "--out", f"{folder}/run"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert run.stdout is not None
        address = next(line.split()[1] for line in run.stdout if line.startswith("view:"))
        next(line for line in run.stdout if "explored" in line)  # the run has ended, the page is still served
        browser = subprocess.Popen([*BROWSER, f"--user-data-dir={folder}/browser", address], stderr=subprocess.DEVNULL)
        time.sleep(DRAWN_S)
        try:
            with urllib.request.urlopen("http://127.0.0.1:9333/json") as found:
                page = next(tab for tab in json.load(found) if tab["type"] == "page")
            socket = websocket.create_connection(page["webSocketDebuggerUrl"], timeout=120)
            shot = ask(socket, "Page.captureScreenshot", format="png")
            Path("view.png").write_bytes(base64.b64decode(shot["data"]))
        finally:
            browser.terminate()
            browser.wait()
            run.send_signal(signal.SIGINT)
            run.wait()


if __name__ == "__main__":
    main()
