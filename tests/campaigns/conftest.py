import contextlib
from collections.abc import Iterator

import pytest


@pytest.fixture
def nearby(monkeypatch):
    """Two workers that are threads of this process, so that a campaign takes a second to begin."""
    distributed = pytest.importorskip("distributed")

    @contextlib.contextmanager
    def connect(*_: object) -> Iterator[object]:
        options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": "127.0.0.1:0"}
        with distributed.Client(**options) as client:
            yield client

    monkeypatch.setattr("sixthsense.campaigns.call.connect", connect)
