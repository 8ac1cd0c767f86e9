"""An executor on the workers of a cluster, with dask.distributed (extra ``dask``): a given one, or one started here.

Results and their order are those of `mixseq.runtime.parallel.serially`, also if a worker dies. Every task carries its
input, including the shared object, so that the scheduler can resend it; *scattered* data would be lost with its worker
[1]_.

References
----------
.. [1] https://distributed.dask.org/en/stable/resilience.html, https://github.com/dask/distributed/issues/3149
"""

from __future__ import annotations

import asyncio
import logging
import pickle
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from itertools import cycle, islice
from tempfile import TemporaryDirectory
from typing import Any, TypeVar
from uuid import uuid4

from mixseq.errors import ClusterError, GivenUpError, MissingExtraError, SettingsError
from mixseq.runtime.parallel import one_blas_thread
from mixseq.version import __version__

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster:
    """An `Executor` on the workers of a cluster; made by `cluster`."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield ``function(shared, item)`` in the order of the items, which are consumed as workers become free."""
        ahead: deque[Any] = deque()
        submit = self._prepare(function, shared)
        many = 2 * self._threads()
        try:
            for item in items:
                ahead.append(submit(item))
                if len(ahead) > many:
                    yield _result(ahead.popleft())
            while ahead:
                yield _result(ahead.popleft())
        finally:
            self._cancel(ahead)

    def as_done(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield every item when it is done, in any order, with a function that returns or raises its result.

        For long work that may kill its worker, with a small shared object. As dask blames all tasks of a dead worker,
        workers get only what they work on. Tasks that dask gave up are retried once at the end, each alone.
        """
        suspects = []
        for item, future in self._as_done(function, shared, items, self._threads):
            if _given_up(future):
                suspects.append(item)
            else:
                yield item, partial(_result, future)
        for item, future in self._as_done(function, shared, suspects, lambda: 1):
            yield item, partial(_result, future)

    def _as_done(
        self,
        function: Callable[[Shared, Item], Result],
        shared: Shared,
        items: Iterable[Item],
        most: Callable[[], int],
    ) -> Iterator[tuple[Item, Any]]:
        """Yield items with their futures as they are done, with at most `most` under way."""
        dumps, name = dask_module("distributed.protocol.pickle").dumps, _name(function)
        waiting = iter(items)
        ahead: dict[Any, Item] = {}
        done = dask_module("distributed").as_completed(loop=self._client.loop)
        try:
            while True:
                free = most() - len(ahead)  # asked again each time, as workers come and go
                for item in islice(waiting, max(0, free)):
                    with _connected():
                        work = dumps((function, shared, item))
                        future = self._client.submit(_apply_alone, work, key=f"{name}-{uuid4()}")
                    ahead[future] = item
                    done.add(future)
                if not ahead:
                    return
                future = next(done)
                yield ahead.pop(future), future
        finally:
            self._cancel(ahead)

    def _threads(self) -> int:
        """Return the current number of worker threads, at least 1, as workers may come back."""
        with _connected():
            threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def _cancel(self, futures: Iterable[Any]) -> None:
        """Cancel futures; errors of a lost connection are ignored, to keep the original error."""
        with suppress(ClusterError), _connected():
            self._client.cancel(list(futures))

    def _prepare(self, function: Callable[..., Any], shared: object) -> Callable[[Any], Any]:
        """Return a function that submits an item."""
        # Pickled here, so that dask does not look for tasks in what it carries.
        dumps, name = dask_module("distributed.protocol.pickle").dumps, _name(function)
        with _connected():
            call = self._client.submit(_call, dumps((function, shared)), key=f"{name}-call-{uuid4()}")
            workers = sorted(self._client.nthreads())
        # In turn: left to itself dask keeps quick tasks where what is shared already is. Others help if one is gone.
        # If there are none just now, whichever comes does the work.
        turns = cycle([{"workers": worker, "allow_other_workers": True} for worker in workers] or [{}])

        def submit(item: object) -> Any:
            with _connected():
                return self._client.submit(_apply, call, dumps(item), key=f"{name}-{uuid4()}", **next(turns))

        return submit


_LOST = "the connection to the scheduler of the cluster was lost; start again"


@contextmanager
def _connected() -> Iterator[None]:
    """Convert dask's connection errors to ClusterError."""
    closed = (
        dask_module("distributed.client").ClosedClientError,
        dask_module("distributed.comm").CommClosedError,
    )
    try:
        yield
    except (*closed, CancelledError, ConnectionError, TimeoutError):
        raise ClusterError(_LOST) from None


def _name(function: Callable[..., Any]) -> str:
    """Return the name of tasks, by which dask groups those of similar duration."""
    return f"mixseq-{getattr(function, '__name__', 'work')}"


def _call(pickled: bytes) -> Callable[[Any], Any]:
    """Bind the function to the shared object on a worker; other workers copy it from there."""
    function, shared = pickle.loads(pickled)
    return partial(function, shared)


def _apply(call: Callable[[Item], Result], item: bytes) -> Result:
    with one_blas_thread():
        return call(pickle.loads(item))


def _apply_alone(work: bytes) -> Any:
    """Apply the function to self-contained work on a worker."""
    function, shared, item = pickle.loads(work)
    with one_blas_thread():
        return function(shared, item)


def _given_up(future: Any) -> bool:
    return future.status == "error" and isinstance(
        future.exception(), dask_module("distributed").KilledWorker
    )


def _result(future: Any) -> Any:
    distributed = dask_module("distributed")
    try:
        return future.result()
    except distributed.KilledWorker:
        raise GivenUpError(
            "several workers died over the same piece of work, which was given up; they may have too little memory"
        ) from None
    except (CancelledError, distributed.client.ClosedClientError, distributed.comm.CommClosedError):
        raise ClusterError(_LOST) from None


def dask_module(module: str) -> Any:
    """Import a module of dask on first use."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            "clusters need dask.distributed; get it with: pip install 'mixseq[dask]'"
        ) from error


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
