"""The workers of a running Dask scheduler as an executor: the only file that knows Dask."""

from __future__ import annotations

import logging
from typing import Any, Self

from sixthsense.campaigns.plan import CampaignPlan, own_parts
from sixthsense.campaigns.worker import describe, one_line
from sixthsense.config.errors import InputError, import_extra
from sixthsense.config.section import shown
from sixthsense.config.version import __version__

REACH_S = 5.0
"""timeout for the scheduler to answer, and for its first worker to connect"""


class Cluster:
    """The workers of a scheduler. Dask repeats the run of a lost worker, and raises KilledWorker after four of them."""

    def __init__(self, scheduler: str) -> None:
        """Connect with the scheduler at an address.

        Raises InputError if Dask is missing, and if the scheduler cannot be reached or has no workers.
        """
        distributed = import_extra("distributed", "campaign")
        for name in logging.root.manager.loggerDict:  # rows and errors tell what is lost
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        try:
            self.client = distributed.Client(scheduler, timeout=REACH_S)
            self.client.wait_for_workers(1, timeout=REACH_S)
        except Exception as error:  # malformed address, network error, or a listener that is not a scheduler
            allowed = "the address of a running dask scheduler with workers, such as tcp://127.0.0.1:8786"
            found = f"{shown(scheduler)} cannot be reached, or has no workers ({one_line(error)})"
            raise InputError("scheduler", found, allowed) from None
        self.submit = self.client.get_executor(pure=False).submit
        """begins a call"""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    @property
    def workers(self) -> int:
        """The number of workers, which may join and leave."""
        return len(self.client.nthreads())


def check_workers(client: Any, campaign: CampaignPlan) -> None:
    """Check that all workers produce the same runs; InputError that names the one that does not.

    Every worker must have this version of the package, this minor version of Python, parts that it can import, and
    scenes of the same content.
    """
    asked = campaign.values["scene"], campaign.bases()[0].map_unknown, own_parts(campaign.settings())
    own = describe(*asked)
    for address, answer in client.run(describe, *asked, on_error="return").items():
        if isinstance(answer, BaseException):
            found = f"found no usable sixthsense ({one_line(answer)})"
            raise InputError(f"worker {address}", found, f"version {__version__}")
        for name, value in own.items():
            if answer[name] != value:
                raise InputError(f"worker {address}", f"found another {name}, {answer[name]}", value)
