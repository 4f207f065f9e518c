"""Files that are there as a whole or not at all: a run may be ended at any moment, also while it is saved."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole(file: Path) -> Iterator[Path]:
    """A path to write in place of `file`, which takes that name when the block has ended without an error.

    Raises OSError that names `file`, and then leaves nothing else behind.
    """
    # The name keeps its suffix, which np.savez would add, and begins with a dot, which readers of Parquet skip.
    unfinished = file.with_name(f".{os.getpid()}.{file.name}")
    try:
        yield unfinished
        with unfinished.open("rb") as content:
            os.fsync(content.fileno())
        unfinished.replace(file)
    except BaseException as error:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(file)  # the error of a full disk names no file
        raise
