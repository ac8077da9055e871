"""A cell of the table: its check is called without output."""

import contextlib
import importlib
import os
import sys
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from peers_table.rows import PEERS, NotThere

FOUND = ("seen", "not seen", "not installed")


def checks_of(peer):
    """{row: check}: a check returns its observation, or raises NotThere."""
    return importlib.import_module(f"peers_table.{PEERS[peer].checks}").CHECKS


def run(peer, row):
    """{"found": one of FOUND, "version", "says"} of a cell. Unexpected exceptions are raised."""
    about = PEERS[peer]
    if find_spec(about.imported) is None:
        return {"found": "not installed", "version": "", "says": about.install}
    try:
        with silent():
            says, result = checks_of(peer)[row](), "seen"
    except NotThere as reason:
        says, result = str(reason), "not seen"
    return {"found": result, "version": version_of(about), "says": says}


def version_of(about):
    """The installed version, or that a copy of its repository is on the path."""
    try:
        return version(about.distribution)
    except PackageNotFoundError:
        return getattr(importlib.import_module(about.imported), "__version__", "a copy")


@contextlib.contextmanager
def silent():
    """Discard the output of the process, that of compiled code included."""
    sys.stdout.flush(), sys.stderr.flush()
    saved, nowhere = [os.dup(number) for number in (1, 2)], os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1), os.dup2(nowhere, 2)
        yield
    finally:
        sys.stdout.flush(), sys.stderr.flush()
        for number, before in zip((1, 2), saved):
            os.dup2(before, number)
        for number in (*saved, nowhere):
            os.close(number)
