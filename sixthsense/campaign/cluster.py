"""The workers of a campaign: a local Dask cluster, or one behind a scheduler that was started by hand."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing import resource_tracker
from typing import Any

from sixthsense.campaign.errors import CampaignError, needed
from sixthsense.campaign.plan import PlannedRun, scene_digest
from sixthsense.campaign.worker import FAILED, OtherVersionError, describe, one_line, python_minor, row_of, run_row
from sixthsense.config.section import shown
from sixthsense.config.version import __version__

REACH_S = 5.0
"""how long a scheduler, and then its first worker, may take to answer"""

_SETTINGS = {
    "distributed.comm.timeouts.connect": f"{REACH_S:g}s",
    "distributed.worker.daemon": True,  # workers end with the process that has started them
}


@contextlib.contextmanager
def connect(scheduler: str | None = None, workers: int | None = None, dashboard: int = 8787) -> Iterator[Any]:
    """A client of the scheduler at an address, or else of a local cluster: processes of one thread each.

    `workers` is their number, by default the processors'; `dashboard` the port on this machine that the local cluster's
    pages prefer. Raises CampaignError where Dask is missing, and for a scheduler that cannot be reached or has no
    workers.
    """
    dask, distributed = needed("dask"), needed("distributed")
    # Lost workers and closed connections are told by what becomes of the runs.
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        stack.enter_context(dask.config.set(_SETTINGS))
        if scheduler is None:
            with _deaf():
                cluster = distributed.LocalCluster(
                    n_workers=workers or dask.system.CPU_COUNT,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=f"127.0.0.1:{dashboard}",
                    silence_logs=logging.CRITICAL,
                )
                stack.callback(_quietly, cluster.close)
            client = distributed.Client(cluster)
        else:
            client = _reach(distributed, scheduler)
        stack.callback(_quietly, client.close)
        if scheduler is not None and not _has_workers(client):
            raise CampaignError(
                f"--scheduler: {shown(scheduler)} has no workers after {REACH_S:g} s, "
                f"allowed: one with some, started with dask worker {scheduler}"
            )
        yield client


def _reach(distributed: Any, address: str) -> Any:
    async def knock() -> None:
        # A client waits for ever where something listens that does not answer.
        secrets = distributed.Security().get_connection_args("client")
        comm = await asyncio.wait_for(distributed.comm.connect(address, timeout=REACH_S, **secrets), REACH_S)
        comm.abort()

    try:
        asyncio.run(knock())
        return distributed.Client(address, timeout=REACH_S)
    except Exception as error:  # of the address's form, of the network, or of what answers there
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        reason = f"no answer in {REACH_S:g} s" if isinstance(error, TimeoutError) else one_line(cause)
        raise CampaignError(
            f"--scheduler: {shown(address)} cannot be reached ({reason}), "
            "allowed: the address of a running dask scheduler, such as tcp://127.0.0.1:8786"
        ) from None


def _has_workers(client: Any) -> bool:
    try:
        client.wait_for_workers(1, timeout=REACH_S)
    except TimeoutError:
        return False
    return True


def check_workers(client: Any, scenes: Sequence[str]) -> int:
    """The number of workers; raises CampaignError, naming it, for one that would not make the same runs as another.

    All must have this version of the package and of Python, down to the minor, and find the same content in the scenes.
    """
    # Nothing can be sent for execution before Python is known to be the same.
    versions = client.get_versions()
    for address, found in {"scheduler": versions["scheduler"], **versions["workers"]}.items():
        minor = ".".join(found["host"]["python"].split(".")[:2])
        if minor != python_minor():
            raise CampaignError(f"worker {address}: found Python {minor}, allowed: {python_minor()}")
    digests = {scene: scene_digest(scene) for scene in scenes}
    answers = client.run(describe, scenes, on_error="return")
    for address, answer in answers.items():
        if isinstance(answer, BaseException):
            raise CampaignError(
                f"worker {address}: found no sixthsense that makes campaigns ({one_line(answer)}), "
                f"allowed: version {__version__}"
            )
        if answer["sixthsense"] != __version__:
            raise CampaignError(
                f"worker {address}: found version {answer['sixthsense']} of sixthsense, allowed: {__version__}"
            )
        for scene, digest in digests.items():
            if answer["scenes"][scene] != digest:
                raise CampaignError(
                    f"worker {address}: the scene {scene} is not the one that is here "
                    f"({answer['scenes'][scene]}), allowed: the same file at the same path"
                )
    return len(answers)


def execute(client: Any, runs: Mapping[str, PlannedRun], on_row: Callable[[dict[str, Any]], None]) -> None:
    """Make the runs, by their hash, on the workers and hand each row over as it comes, every run once.

    A run whose worker dies is made again elsewhere; when that has happened more often than the scheduler's
    `allowed-failures` (3 by default) it is a row that says so. Raises CampaignError when the scheduler is lost or a
    worker with another version of the package joins, and what `on_row` raises; runs under way are then given up.
    """
    waiting = iter(runs.items())
    planned: dict[str, PlannedRun] = {}
    futures = needed("distributed").as_completed(loop=client.loop)

    def fill() -> None:
        # One run per worker and none ahead: a worker that dies takes no other down with it.
        for _ in range(max(1, len(client.nthreads())) - len(planned)):
            key, run = next(waiting, (None, None))
            if key is None or run is None:
                return
            name = f"sixthsense-{key}"
            planned[name] = run
            futures.add(client.submit(run_row, run.config, __version__, key=name))

    with _connected():
        fill()
    for batch in futures.batches():
        for future in batch:
            if future.status == "pending":  # its worker died with the row, and it is made again
                futures.add(future)
                continue
            run = planned.pop(future.key)
            with _connected():
                fill()
                row = _row(future, run)
            on_row(row)
            future.release()


@contextlib.contextmanager
def _connected() -> Iterator[None]:
    """A scheduler that is lost within the block is a CampaignError."""
    from concurrent.futures import CancelledError

    try:
        yield
    except (OSError, CancelledError):
        raise CampaignError(
            "scheduler: found the connection lost; the rows so far are kept, allowed: the same command again"
        ) from None


def _row(future: Any, run: PlannedRun) -> dict[str, Any]:
    """The row of a run that is over, whether or not a worker has lived to write it.

    Raises OSError or CancelledError when the scheduler is lost.
    """
    from concurrent.futures import CancelledError

    try:
        row: dict[str, Any] = future.result()
        return row
    except (OSError, CancelledError):
        raise
    except OtherVersionError as error:
        raise CampaignError(f"worker: one that joined late {error}") from None
    except Exception as error:
        # Its own text is a paragraph.
        killed = type(error).__name__ == "KilledWorker"
        reason = f"KilledWorker: {error.args[2] + 1} workers died in this run" if killed else one_line(error)
    return {**row_of(run.config), "version": __version__, "outcome": FAILED, "error": reason}


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Ctrl-C waits until the block is over; processes and threads that are started in it never hear it.

    A terminal sends it to all of them, but it is for the driver alone to end the others.
    """
    resource_tracker.ensure_running()  # or else the first process to be started would be heard
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _quietly(close: Callable[[], Any]) -> None:
    """Close what may already be gone; an impatient second Ctrl-C leaves no processes behind."""
    with _deaf(), contextlib.suppress(Exception):
        close()
