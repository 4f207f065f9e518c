import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest


class Threads(ThreadPoolExecutor):
    """Two threads of this process, so that a campaign begins at once."""

    workers = 2


@pytest.fixture
def nearby(monkeypatch):
    @contextlib.contextmanager
    def executor(*_: object) -> Iterator[Threads]:
        with Threads(2) as threads:
            yield threads

    monkeypatch.setattr("sixthsense.campaigns.call._executor", executor)
