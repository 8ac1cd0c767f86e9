"""Work on several processes or machines, with dask.distributed (extra ``dask``).

A cluster is an `OrderedMap`: the same function, shared object and items give the same results in the same order as
`mixseq.mapping.serially`. A worker that dies costs time, not results. Everything that a task needs is part of a task
that the scheduler can send again, the shared object too: data that is merely *scattered* is gone with its worker [1]_.

References
----------
.. [1] https://distributed.dask.org/en/stable/resilience.html, https://github.com/dask/distributed/issues/3149
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import cycle
from tempfile import TemporaryDirectory
from typing import Any, TypeVar
from uuid import uuid4

from mixseq.errors import ClusterError, GivenUpError, MissingExtraError, SettingsError
from mixseq.threads import one_blas_thread
from mixseq.version import __version__

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE = 10.0
"""Seconds to wait for a scheduler to answer, and for it to have workers."""

_ONE_THREAD = dict.fromkeys(
    ("MIXSEQ_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """Connect to a cluster, or start one here, for as long as the block lasts.

    Parameters
    ----------
    address : str
        Address of a scheduler, ``tcp://host:8786``, or ``local:N`` for N processes on this machine with a thread each.
        Scripts that start processes need ``if __name__ == "__main__":`` around what they do.

    Yields
    ------
    Cluster
        An `OrderedMap`.

    Raises
    ------
    SettingsError
        If the address is none.
    ClusterError
        If nobody answers there, there are no workers, or they have another version of mixseq.
    MissingExtraError
        If dask.distributed is not installed.
    """
    processes = _local_processes(address)
    distributed = _dask("distributed")  # first: it brings the settings, of which we change one
    # Items may be blocks of frames: large, but never many at once, which is all that dask warns about.
    unwarned = _dask("dask.config").set({"distributed.admin.large-graph-warning-threshold": "1 TiB"})
    with unwarned, distributed.utils.silence_logging_cmgr(logging.CRITICAL):
        if processes:
            with _local(processes) as started, distributed.Client(started, set_as_default=False) as client:
                yield Cluster(client)
        else:
            _check_scheduler(address)
            with distributed.Client(address, set_as_default=False) as client:
                _check_workers(client, address)
                yield Cluster(client)


class Cluster:
    """An `OrderedMap` over the workers of a cluster; made by `cluster`.

    Parameters
    ----------
    client : distributed.Client
        The connection.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield ``function(shared, item)`` for every item, in order.

        Items are taken as results are: there are never more under way than keep the workers busy.

        Raises
        ------
        GivenUpError
            If several workers died over an item.
        ClusterError
            If the scheduler is gone.
        """
        ahead: deque[Any] = deque()
        submit, many = self._prepare(function, shared)
        try:
            for item in items:
                ahead.append(submit(item))
                if len(ahead) > many:
                    yield _result(ahead.popleft())
            while ahead:
                yield _result(ahead.popleft())
        finally:
            self._client.cancel(list(ahead))

    def as_done(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield every item when it is done, in any order, with a function that returns or raises its result."""
        submit, many = self._prepare(function, shared)
        waiting = iter(items)
        ahead: dict[Any, Item] = {}
        done = _dask("distributed").as_completed(loop=self._client.loop)

        def fill() -> None:
            while len(ahead) <= many and (item := next(waiting, _NOTHING)) is not _NOTHING:
                future = submit(item)
                ahead[future] = item
                done.add(future)

        try:
            fill()
            while ahead:
                future = next(done)
                yield ahead.pop(future), lambda future=future: _result(future)  # type: ignore[misc]
                fill()
        finally:
            self._client.cancel(list(ahead))

    def _prepare(self, function: Callable[..., Any], shared: object) -> tuple[Callable[[Any], Any], int]:
        """Return what submits an item, and how many should be under way."""
        # Pickled here, so that dask does not look for tasks in what it carries. Named by the function: by their names
        # dask knows tasks that take as long as each other.
        dumps = _dask("distributed.protocol.pickle").dumps
        name = f"mixseq-{getattr(function, '__name__', 'work')}"
        call = self._client.submit(_call, dumps((function, shared)), key=f"{name}-call-{uuid4()}")
        try:
            threads = self._client.nthreads()
        except OSError:
            raise ClusterError(_LOST) from None
        # In turn: left to itself dask keeps quick tasks where what is shared already is. Others help if one is gone.
        turns = cycle(sorted(threads) or [None])

        def submit(item: object) -> Any:
            key = f"{name}-{uuid4()}"
            return self._client.submit(
                _apply, call, dumps(item), key=key, workers=next(turns), allow_other_workers=True
            )

        return submit, 2 * max(1, sum(threads.values()))


_NOTHING: Any = object()

_LOST = "the connection to the scheduler of the cluster was lost; start again"


def _call(pickled: bytes) -> Callable[[Any], Any]:
    """Return the function with what is shared, on a worker; others copy it from there."""
    function, shared = pickle.loads(pickled)
    return partial(function, shared)


def _apply(call: Callable[[Item], Result], item: bytes) -> Result:
    """Do the work, on a worker."""
    with one_blas_thread():
        return call(pickle.loads(item))


def _result(future: Any) -> Any:
    try:
        return future.result()
    except _dask("distributed").KilledWorker:
        raise GivenUpError(
            "several workers died over the same piece of work, which was given up; they may have too little memory"
        ) from None
    except CancelledError:
        raise ClusterError(_LOST) from None


def _dask(module: str) -> Any:
    """Import a module when it is needed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            "clusters need dask.distributed; get it with: pip install 'mixseq[dask]'"
        ) from error


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
    """Start workers on this machine that leave nothing behind."""
    with (
        TemporaryDirectory(prefix="mixseq-", ignore_cleanup_errors=True) as folder,
        _dask("dask.config").set({"temporary-directory": folder}),
        _dask("distributed").LocalCluster(
            n_workers=processes,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",  # the scheduler insists on a port
            scheduler_kwargs={"dashboard": False},
            silence_logs=logging.CRITICAL,
            memory_limit=None,  # a worker is not killed for using the memory that there is
            local_directory=folder,
            env=_ONE_THREAD,
        ) as started,
    ):
        yield started


def _check_scheduler(address: str) -> None:
    """Refuse an address where nobody answers; a client that cannot connect would go on trying."""

    async def identity() -> None:
        async with _dask("distributed").rpc(address) as scheduler:
            await asyncio.wait_for(scheduler.identity(), PATIENCE)

    try:
        asyncio.run(identity())
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; start one with `dask scheduler`, or give local:N for processes here"
        ) from error


def _check_workers(client: Any, address: str) -> None:
    """Refuse a cluster that has no workers, or where mixseq is another one."""

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
