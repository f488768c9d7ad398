"""One thread of the linear algebra, whose matrices are small here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold the linear algebra to one thread, as a context or as the decorator of a function.

    On a busy machine threads of BLAS that wait for one another made `compare` thirty times slower
    (83 s in place of 2.9 s on two cores under load).
    """
    import scipy.linalg  # noqa: F401  (a library that is not loaded yet cannot be limited)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield
