from concurrent.futures import ThreadPoolExecutor

import pytest


class Threads(ThreadPoolExecutor):
    """Two threads of this process, so that a campaign begins at once."""

    workers = 2


@pytest.fixture
def nearby(monkeypatch):
    monkeypatch.setattr("sixthsense.campaigns.call.Processes", lambda *_: Threads(2))
