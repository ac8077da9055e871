"""Guard for readers of untrusted files: no printing, no exit, bounded memory, one at a time."""

import contextlib
import io
import threading
import warnings

_ONE_AT_A_TIME = threading.Lock()  # what is redirected and limited below belongs to the whole process


@contextlib.contextmanager
def quiet():
    """Everything printed inside goes to the yielded StringIO, warnings are dropped."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield said


@contextlib.contextmanager
def bounded_memory(extra):
    """MemoryError for allocations beyond `extra` bytes above what the process uses now; nothing where unsupported."""
    try:
        import resource

        with open("/proc/self/statm", encoding="ascii") as statm:
            used = int(statm.read().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        bounds = [bound for bound in (used + extra, soft, hard) if bound != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min(bounds), hard))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextlib.contextmanager
def guarded(file_size):
    """quiet() and bounded_memory() of 2 GiB and 200 times the file, under a lock."""
    with _ONE_AT_A_TIME, bounded_memory(2**31 + 200 * file_size), quiet() as said:
        yield said
