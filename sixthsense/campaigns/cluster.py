"""The workers of a campaign: a local Dask cluster, or the workers of a running Dask scheduler."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import resource_tracker
from typing import Any

from sixthsense.campaigns.plan import CampaignPlan, PlannedRun, import_extra, own_parts
from sixthsense.campaigns.worker import FAILED, OtherVersionError, describe, one_line, python_minor, row_of, run_row
from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.config.version import __version__
from sixthsense.core.interrupt import deferred_interrupt

REACH_S = 5.0
"""timeout for the scheduler to answer, and for its first worker to connect"""

_SETTINGS = {
    "distributed.comm.timeouts.connect": f"{REACH_S:g}s",
    "distributed.worker.daemon": True,  # workers end with the process that started them
}


@contextlib.contextmanager
def connect(scheduler: str | None = None, workers: int | None = None, dashboard: int = 8787) -> Iterator[Any]:
    """Connect to the scheduler at an address, or start a local cluster of processes with one thread each.

    `workers` is the number of local processes, by default one per processor. `dashboard` is the preferred port of the
    local cluster's dashboard. Raises InputError if Dask is missing, if the scheduler cannot be reached, and if it
    has no workers.
    """
    dask, distributed = import_extra("dask"), import_extra("distributed")
    # Silence Dask's log: the runs' rows report lost workers, and InputError a lost scheduler.
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        stack.enter_context(dask.config.set(_SETTINGS))
        stack.enter_context(_script_hidden())
        if scheduler is None:
            # A cluster that is stopped half started leaves processes, and says so when Python ends.
            with deferred_interrupt() as interrupted, _terminal_blocked():
                cluster = distributed.LocalCluster(
                    n_workers=workers or dask.system.CPU_COUNT,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=f"127.0.0.1:{dashboard}",
                    silence_logs=logging.CRITICAL,
                )
                stack.callback(_close_quietly, cluster.close)
            if interrupted():
                raise KeyboardInterrupt
            client = distributed.Client(cluster)
        else:
            client = _reach(distributed, scheduler)
        stack.callback(_close_quietly, client.close)
        if scheduler is not None and not _has_workers(client):
            raise InputError(
                "scheduler",
                f"{shown(scheduler)} has no workers after {REACH_S:g} s",
                f"a scheduler with workers, started with dask worker {scheduler}",
            )
        yield client


def _reach(distributed: Any, address: str) -> Any:
    async def try_connection() -> None:
        # The client would wait without a timeout for a listener that does not answer.
        secrets = distributed.Security().get_connection_args("client")
        comm = await asyncio.wait_for(distributed.comm.connect(address, timeout=REACH_S, **secrets), REACH_S)
        comm.abort()

    try:
        asyncio.run(try_connection())
        return distributed.Client(address, timeout=REACH_S)
    except Exception as error:  # malformed address, network error, or a listener that is not a scheduler
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        reason = f"no answer in {REACH_S:g} s" if isinstance(error, TimeoutError) else one_line(cause)
        raise InputError(
            "scheduler",
            f"{shown(address)} cannot be reached ({reason})",
            "the address of a running dask scheduler, such as tcp://127.0.0.1:8786",
        ) from None


def _has_workers(client: Any) -> bool:
    try:
        client.wait_for_workers(1, timeout=REACH_S)
    except TimeoutError:
        return False
    return True


def check_workers(client: Any, campaign: CampaignPlan) -> int:
    """Check that all workers produce the same runs, and return their number.

    Raises InputError that names the worker. Every worker must have this version of the package, this minor version
    of Python, and scenes of the same content.
    """
    # Functions can be pickled between equal minor versions of Python only, so this check comes first.
    versions = client.get_versions()
    for address, found in {"scheduler": versions["scheduler"], **versions["workers"]}.items():
        minor = ".".join(found["host"]["python"].split(".")[:2])
        if minor != python_minor():
            raise InputError(f"worker {address}", f"found Python {minor}", f"{python_minor()}")
    digests, map_unknown = campaign.digests(), campaign.bases()[0].map_unknown
    parts = own_parts(campaign.settings())
    answers = client.run(describe, list(digests), map_unknown, parts, on_error="return")
    for address, answer in answers.items():
        if isinstance(answer, BaseException):
            raise InputError(
                f"worker {address}", f"found no usable sixthsense ({one_line(answer)})", f"version {__version__}"
            )
        if answer["sixthsense"] != __version__:
            raise InputError(f"worker {address}", f"found version {answer['sixthsense']} of sixthsense", __version__)
        for missing in answer["missing"]:
            found = f"{missing.partition(', allowed')[0]} (Python {answer['python']} in {answer['environment']})"
            raise InputError(f"worker {address}", found, "the module of the part in the worker's environment")
        for scene, digest in digests.items():
            if answer["scenes"][scene] != digest:
                raise InputError(
                    f"worker {address}",
                    f"found another scene {scene} than on this machine ({answer['scenes'][scene]})",
                    "the same file at the same path",
                )
    return len(answers)


def execute(client: Any, runs: Mapping[str, PlannedRun], on_row: Callable[[dict[str, Any]], None]) -> None:
    """Execute the runs, given by hash, on the workers, and call `on_row` once per run when its row arrives.

    A run whose worker dies is repeated on another worker. After more deaths than the scheduler's `allowed-failures`
    (3 by default) its row has the outcome "error". Raises InputError when the scheduler is lost or a worker with
    another version of the package joins, and any exception of `on_row`. Unfinished runs are then cancelled.
    """
    waiting = iter(runs.items())
    planned: dict[str, PlannedRun] = {}
    futures = import_extra("distributed").as_completed(loop=client.loop)

    def submit_next() -> None:
        # One run per worker and no queue: a worker that dies loses one run only.
        for _ in range(max(1, len(client.nthreads())) - len(planned)):
            key, run = next(waiting, (None, None))
            if key is None or run is None:
                return
            name = f"sixthsense-{key}"
            planned[name] = run
            futures.add(client.submit(run_row, run.config, __version__, key=name))

    with _scheduler_errors():
        submit_next()
    for batch in futures.batches():
        for future in batch:
            if future.status == "pending":  # its worker died before the row was fetched; Dask repeats the run
                futures.add(future)
                continue
            run = planned.pop(future.key)
            with _scheduler_errors():
                submit_next()
                row = _row(future, run)
            on_row(row)
            future.release()


@contextlib.contextmanager
def _scheduler_errors() -> Iterator[None]:
    """Convert the loss of the scheduler within the block into an InputError."""
    from concurrent.futures import CancelledError

    try:
        yield
    except (OSError, CancelledError):
        raise InputError(
            "scheduler", "found the connection lost, the finished rows are kept", "the same command again"
        ) from None


def _row(future: Any, run: PlannedRun) -> dict[str, Any]:
    """The row of a finished run; a row with the outcome `FAILED` if the run or its worker failed.

    Raises OSError or CancelledError when the scheduler is lost.
    """
    from concurrent.futures import CancelledError

    try:
        row: dict[str, Any] = future.result()
        return row
    except (OSError, CancelledError):
        raise
    except OtherVersionError as error:
        raise InputError("worker that joined late", str(error)) from None
    except Exception as error:
        # The message of KilledWorker is several sentences long.
        killed = type(error).__name__ == "KilledWorker"
        reason = f"KilledWorker: {error.args[2] + 1} workers died in this run" if killed else one_line(error)
    return {**row_of(run.config), "version": __version__, "outcome": FAILED, "error": reason}


@contextlib.contextmanager
def _terminal_blocked() -> Iterator[None]:
    """Block SIGINT and SIGHUP within the block; processes and threads that are started in it inherit the mask.

    A terminal sends them to all processes of the group, and only the driver may end the workers.
    """
    resource_tracker.ensure_running()  # starting it with the first process would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _script_hidden() -> Iterator[None]:
    """Within the block new processes do not import the program that is running.

    A script that calls `ss.campaign` outside of `if __name__ == "__main__"` would begin again in each of them.
    """
    main = sys.modules["__main__"]
    before = {name: getattr(main, name) for name in ("__spec__", "__file__") if hasattr(main, name)}
    main.__spec__ = None
    vars(main).pop("__file__", None)
    try:
        yield
    finally:
        vars(main).update(before)


def _close_quietly(close: Callable[[], Any]) -> None:
    """Close a cluster or client, ignoring errors; SIGINT and SIGHUP are blocked so that no process is left behind."""
    with _terminal_blocked(), contextlib.suppress(Exception):
        close()
