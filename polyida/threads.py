"""One BLAS thread while a run goes on: on small matrices more threads cost more than they bring."""

from contextlib import contextmanager


@contextmanager
def one_blas_thread():
    """Limit the BLAS libraries of this process to one thread, and give back what was set."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
