"""Commands as processes of their own, and waiting for what they do."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any


def _listen() -> None:
    """In the child: no signal is ignored, as they are under nohup and in the background of a shell."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def start(*words: str, program: str = "", **options: Any) -> subprocess.Popen[str]:
    # As the installed script does it; with -m Python may end by the signal itself, which a shell shows as 130, too.
    code = f"{program}\nimport sys; from sixthsense.cli import main; sys.exit(main())"
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "preexec_fn": _listen}
    return subprocess.Popen([sys.executable, "-c", code, *words], **(piped | options))


def wait_until(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + 240.0
    while not is_so():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.01)
