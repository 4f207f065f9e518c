"""`--view`: the hook that shows a run live, and keeps the browser view open after the run."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from sixthsense.cli.options import UsageError
from sixthsense.core.interrupt import is_command_ended
from sixthsense.view.target import LOOPBACK

if TYPE_CHECKING:
    from sixthsense.cli.common import Common
    from sixthsense.loop import OnTick


@contextlib.contextmanager
def live_view(options: Common) -> Iterator[tuple[OnTick, ...]]:
    """The hooks of `--view`, none without the option; a browser view stays open after the run until Ctrl-C."""
    if options.bind is not None and options.view != "browser":
        raise UsageError("--bind: found without --view browser, allowed: with it")
    if options.view is None:
        yield ()
        return
    from sixthsense.view.recording import View

    with View(options.view, options.bind or LOOPBACK) as view:
        if view.page:
            print(f"view: {view.page}", file=sys.stderr)
        yield (view,)
        view.finish()
        if view.page and not (view.is_interrupted or is_command_ended()):
            print("the view stays open until Ctrl-C", file=sys.stderr)
            with contextlib.suppress(KeyboardInterrupt):
                view.wait()
