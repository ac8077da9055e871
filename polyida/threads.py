"""One BLAS thread while a run goes on: on small matrices more threads cost more than they bring."""

import threading
from contextlib import contextmanager

_lock = threading.Lock()
_inside: list = []  # the limit in force, and one entry for each run within it


@contextmanager
def one_blas_thread():
    """Limit the BLAS libraries of this process to one thread; the last of several runs at once gives back what was set."""
    from threadpoolctl import threadpool_limits

    with _lock:
        if not _inside:
            _inside.append(threadpool_limits(limits=1, user_api="blas"))
        _inside.append(None)
    try:
        yield
    finally:
        with _lock:
            _inside.pop()
            if len(_inside) == 1:
                _inside.pop().restore_original_limits()
