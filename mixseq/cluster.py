"""Clusters of processes or machines: connect to one, or start one locally (extra ``dask``)."""

from __future__ import annotations

import asyncio
import logging
import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from typing import Any

from mixseq.dask_executor import Cluster, dask_module
from mixseq.errors import ClusterError, SettingsError
from mixseq.version import __version__

__all__ = ["Cluster", "cluster"]

PATIENCE = 10.0
"""Seconds to wait for a scheduler to answer, and for it to have workers."""

_ONE_THREAD = dict.fromkeys(
    ("MIXSEQ_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Connect to a cluster, or start a local one, for the duration of the block."""
    processes = _local_processes(address)
    distributed = dask_module("distributed")  # first: it brings the settings, of which we change one
    # Items may be blocks of frames: large, but never many at once, which is all that dask warns about.
    unwarned = dask_module("dask.config").set({"distributed.admin.large-graph-warning-threshold": "1 TiB"})
    with unwarned, distributed.utils.silence_logging_cmgr(logging.CRITICAL):
        if processes:
            with _local(processes) as started, distributed.Client(started, set_as_default=False) as client:
                yield Cluster(client)
        else:
            _check_scheduler(address)
            with distributed.Client(address, set_as_default=False) as client:
                _check_workers(client, address)
                yield Cluster(client)


def _local_processes(address: str) -> int:
    """Return N of ``local:N``, 0 for other addresses."""
    if address.partition(":")[0] != "local":
        return 0
    number = re.fullmatch(r"local:([1-9]\d{0,3})", address)
    if not number:
        raise SettingsError(
            f"the cluster {address!r} is none; give local:N for N processes here, or tcp://host:8786"
        )
    return int(number[1])


@contextmanager
def _local(processes: int) -> Iterator[Any]:
    """Start workers on this machine, with temporary files removed afterwards."""
    with (
        TemporaryDirectory(prefix="mixseq-", ignore_cleanup_errors=True) as folder,
        dask_module("dask.config").set({"temporary-directory": folder}),
        _local_cluster(processes, folder) as started,
    ):
        yield started


def _local_cluster(processes: int, folder: str) -> Any:
    with _ignoring_interrupts():
        try:
            return dask_module("distributed").LocalCluster(
                n_workers=processes,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",  # the scheduler insists on a port
                scheduler_kwargs={"dashboard": False},
                silence_logs=logging.CRITICAL,
                memory_limit=None,  # a worker is not killed for using the memory that there is
                local_directory=folder,
                env=_ONE_THREAD,
            )
        except RuntimeError as error:
            raise ClusterError(
                f"no processes could be started ({error}); scripts need `if __name__ == '__main__':` around their work"
            ) from error


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Start processes that ignore Ctrl-C on the terminal; the main process ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _check_scheduler(address: str) -> None:
    """Raise ClusterError if no scheduler answers; a client would retry forever."""

    async def identity() -> None:
        async with dask_module("distributed").rpc(address) as scheduler:
            await asyncio.wait_for(scheduler.identity(), PATIENCE)

    try:
        asyncio.run(identity())
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; start one with `dask scheduler`, or give local:N for processes here"
        ) from error


def _check_workers(client: Any, address: str) -> None:
    """Raise ClusterError if there are no workers, or one has another version of mixseq."""

    def installed() -> str:  # not a function of this module, which workers without mixseq could not load
        from mixseq.version import __version__ as version

        return version

    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise ClusterError(
            f"the cluster at {address} has no workers; start some with `dask worker {address}`"
        ) from None
    for worker, version in client.run(installed, on_error="return").items():
        if version != __version__:
            there = "no mixseq" if isinstance(version, Exception) else f"mixseq {version}"
            raise ClusterError(
                f"the worker {worker} has {there}, we have {__version__}; install mixseq=={__version__} there"
            )
