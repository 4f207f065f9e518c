"""`--view`: the hook that shows a run as it goes, and what is done when it is over."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING

from sixthsense.cli.options import UsageError
from sixthsense.view.viewer import LOOPBACK

if TYPE_CHECKING:
    from sixthsense.cli.common import Common
    from sixthsense.loop import OnTick


@contextlib.contextmanager
def live_view(options: Common) -> Iterator[tuple[OnTick, ...]]:
    """The hooks that `--view` asks for, none without it; a browser's page then stays until Ctrl-C."""
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
        if view.page and not view.is_interrupted:
            print("the view stays until Ctrl-C", file=sys.stderr)
            with contextlib.suppress(KeyboardInterrupt):
                view.wait()
