"""An executor on the workers of a cluster, with dask.distributed (extra ``dask``), or on processes of this machine.

Results and their order are as with `serial_executor`, even if a worker dies. Every task contains its input and the
shared object, so that the scheduler can resend the task. *Scattered* data would be lost with a worker [1]_.

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
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from itertools import cycle, islice
from typing import Any, TypeVar
from uuid import uuid4

from mixseq.errors import ClusterError, GivenUpError, MissingExtraError, SettingsError
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.processes import ProcessPool, process_pool
from mixseq.version import __version__

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class ClusterExecutor:
    """An `Executor` on the workers of a cluster; made by `connect_to_cluster`."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._is_lost = False

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield ``function(shared, item)`` in the order of the items; items are consumed when workers become free."""
        pending: deque[Any] = deque()
        submit = self._prepare(function, shared)
        max_pending = 2 * self._thread_count()
        try:
            for item in items:
                pending.append(submit(item))
                if len(pending) > max_pending:
                    yield _result(pending.popleft())
            while pending:
                yield _result(pending.popleft())
        finally:
            self._cancel(pending)

    def as_completed(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield every item when it is done, in any order, and a function that returns or raises its result.

        For long tasks that may kill their worker, with a small shared object. Dask blames all tasks of a dead worker,
        so each worker gets one task per thread. Tasks given up by dask are retried at the end, one at a time.
        """
        suspects = []
        for item, future in self._submit_items(function, shared, items, self._thread_count):
            if _was_given_up(future):
                suspects.append(item)
            else:
                yield item, partial(_result, future)
        for item, future in self._submit_items(function, shared, suspects, lambda: 1):
            yield item, partial(_result, future)

    def _submit_items(
        self,
        function: Callable[[Shared, Item], Result],
        shared: Shared,
        items: Iterable[Item],
        max_pending: Callable[[], int],
    ) -> Iterator[tuple[Item, Any]]:
        """Yield items with their futures when they are done; submit at most `max_pending()` items at a time."""
        dumps, name = dask_module("distributed.protocol.pickle").dumps, _task_name(function)
        remaining = iter(items)
        pending: dict[Any, Item] = {}
        completed = dask_module("distributed").as_completed(loop=self._client.loop)
        try:
            while True:
                free = max_pending() - len(pending)  # the number of workers changes
                for item in islice(remaining, max(0, free)):
                    with self._connected():
                        work = dumps((function, shared, item))
                        future = self._client.submit(_apply_alone, work, key=f"{name}-{uuid4()}")
                    pending[future] = item
                    completed.add(future)
                if not pending:
                    return
                future = next(completed)
                yield pending.pop(future), future
        finally:
            self._cancel(pending)

    def _thread_count(self) -> int:
        """Return the current number of worker threads, at least 1, as lost workers may reconnect."""
        with self._connected():
            threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Convert connection errors to ClusterError; after one, raise it at once, as dask would wait half a minute."""
        if self._is_lost or self._client.status != "running":
            raise ClusterError(_CONNECTION_LOST)
        try:
            with _convert_errors():
                yield
        except ClusterError:
            self._is_lost = True
            raise

    def _cancel(self, futures: Iterable[Any]) -> None:
        """Cancel futures; ignore a lost connection, so that the original error is raised."""
        with suppress(ClusterError), self._connected():
            self._client.cancel(list(futures))

    def _prepare(self, function: Callable[..., Any], shared: object) -> Callable[[Any], Any]:
        """Send the function and shared object to a worker; return a function that submits an item."""
        # Arguments are pickled here, so that dask does not search them for tasks.
        dumps, name = dask_module("distributed.protocol.pickle").dumps, _task_name(function)
        with self._connected():
            call = self._client.submit(_bind, dumps((function, shared)), key=f"{name}-call-{uuid4()}")
            workers = sorted(self._client.nthreads())
        # Workers take turns, as dask would favour workers with the shared object; lost workers are replaced by any.
        turns = cycle([{"workers": worker, "allow_other_workers": True} for worker in workers] or [{}])

        def submit(item: object) -> Any:
            with self._connected():
                return self._client.submit(_apply, call, dumps(item), key=f"{name}-{uuid4()}", **next(turns))

        return submit


_CONNECTION_LOST = "the connection to the scheduler of the cluster was lost; start again"


@contextmanager
def _convert_errors() -> Iterator[None]:
    """Convert dask's connection errors to ClusterError."""
    closed = (
        dask_module("distributed.client").ClosedClientError,
        dask_module("distributed.comm").CommClosedError,
    )
    try:
        yield
    except (*closed, CancelledError, OSError):
        raise ClusterError(_CONNECTION_LOST) from None


def _task_name(function: Callable[..., Any]) -> str:
    """Return the common name of the tasks of a function; dask estimates durations by task name."""
    return f"mixseq-{getattr(function, '__name__', 'work')}"


def _bind(pickled: bytes) -> Callable[[Any], Any]:
    """Bind the function to the shared object on a worker, from which other workers copy the result."""
    function, shared = pickle.loads(pickled)
    return partial(function, shared)


def _apply(call: Callable[[Item], Result], item: bytes) -> Result:
    with one_blas_thread():
        return call(pickle.loads(item))


def _apply_alone(work: bytes) -> Any:
    """Unpickle a function, shared object and item on a worker, and apply the function."""
    function, shared, item = pickle.loads(work)
    with one_blas_thread():
        return function(shared, item)


def _was_given_up(future: Any) -> bool:
    return future.status == "error" and isinstance(future.exception(), dask_module("distributed").KilledWorker)


def _result(future: Any) -> Any:
    distributed = dask_module("distributed")
    try:
        return future.result()
    except distributed.KilledWorker:
        raise GivenUpError(
            "several workers died while they did the same task, which was given up; they may need more memory"
        ) from None
    except (CancelledError, distributed.client.ClosedClientError, distributed.comm.CommClosedError):
        raise ClusterError(_CONNECTION_LOST) from None


def dask_module(module: str) -> Any:
    """Import a module of dask on first use."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingExtraError("clusters need dask.distributed; get it with: pip install 'mixseq[dask]'") from error


CONNECT_TIMEOUT_SECONDS = 10.0
"""Time in which a scheduler must answer and at least one worker must connect."""


@contextmanager
def connect_to_cluster(address: str) -> Iterator[ClusterExecutor | ProcessPool]:
    """Connect to a cluster, or start processes of this machine, for the duration of the block."""
    if address.partition(":")[0] == "local":
        match = re.fullmatch(r"local:([1-9]\d{0,3})", address)
        if not match:
            raise SettingsError(
                f"{address!r} is no cluster; give local:N for N processes on this machine, or tcp://host:8786"
            )
        with process_pool(int(match[1])) as pool:
            yield pool
        return
    distributed = dask_module("distributed")  # imported first, as the import sets the configuration changed below
    # Warnings about large tasks are off: items may be large blocks of frames, but few are sent at a time.
    unwarned = dask_module("dask.config").set({"distributed.admin.large-graph-warning-threshold": "1 TiB"})
    with unwarned, distributed.utils.silence_logging_cmgr(logging.CRITICAL):
        _check_scheduler(address)
        with distributed.Client(address, set_as_default=False) as client:
            _check_workers(client, address)
            yield ClusterExecutor(client)


def _check_scheduler(address: str) -> None:
    """Raise ClusterError if no scheduler answers; without this check, a client would retry forever."""

    async def identity() -> None:
        async with dask_module("distributed").rpc(address) as scheduler:
            await asyncio.wait_for(scheduler.identity(), CONNECT_TIMEOUT_SECONDS)

    try:
        asyncio.run(identity())
    except (OSError, ValueError, TimeoutError) as error:
        raise ClusterError(
            f"no scheduler answers at {address}; start one with `dask scheduler`, or give local:N for processes here"
        ) from error


def _check_workers(client: Any, address: str) -> None:
    """Raise ClusterError if there are no workers, or a worker has another version of mixseq."""

    def installed() -> str:  # a local function, as workers without mixseq cannot load functions of this module
        from mixseq.version import __version__ as version

        return version

    try:
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_SECONDS)
    except TimeoutError:
        raise ClusterError(
            f"the cluster at {address} has no workers; start some with `dask worker {address}`"
        ) from None
    for worker, version in client.run(installed, on_error="return").items():
        if version != __version__:
            installed_there = "no mixseq" if isinstance(version, Exception) else f"mixseq {version}"
            raise ClusterError(
                f"the worker {worker} has {installed_there}, this machine {__version__}; "
                f"install mixseq=={__version__} on the worker"
            )
