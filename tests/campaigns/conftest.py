from concurrent.futures import ThreadPoolExecutor

import pytest


class Threads(ThreadPoolExecutor):
    """A thread of this process in place of two, so that a campaign begins at once."""

    workers = 2


@pytest.fixture
def nearby(monkeypatch):
    monkeypatch.setattr("sixthsense.campaigns.call.Processes", lambda *_: Threads(1))
