"""One thread for linear algebra, so that results do not depend on the number of threads.

A library that splits a matrix product over threads adds numbers in another order, and the last bits change; small
products, of which we have many, get slower on top.
"""

from __future__ import annotations

from contextlib import AbstractContextManager


def one_blas_thread() -> AbstractContextManager[object]:
    """Return a context in which BLAS and LAPACK use one thread."""
    from threadpoolctl import threadpool_limits

    limits: AbstractContextManager[object] = threadpool_limits(limits=1, user_api="blas")
    return limits
