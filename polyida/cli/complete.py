"""What the shell offers for a word that is begun: names of the registry, of the studies, and files. Nothing is imported or executed for it."""

from glob import escape, glob

from polyida import registry
from polyida.cli import scripts

ALIASES = ("alpha", "ida", "radau", "energy")


def scenes(incomplete: str) -> list[str]:
    """Named problems, and files that may hold one."""
    return _begun(registry.problems, incomplete) + _files(incomplete)


def integrator(incomplete: str) -> list[str]:
    """Integrators that have a name, and files that may hold one."""
    return _begun([*ALIASES, *registry.integrators], incomplete) + _files(incomplete)


def integrators(incomplete: str) -> list[str]:
    """The same for the last of several with commas."""
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in integrator(last)]


def studies(incomplete: str) -> list[str]:
    """Studies that have a name, and files that may hold one."""
    return _begun([*scripts.scripts(), *registry.studies], incomplete.replace("_", "-")) + _files(incomplete)


def _begun(names, incomplete):
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete):
    """Python files, and folders on the way to them."""
    return sorted(glob(f"{escape(incomplete)}*.py")) + sorted(glob(f"{escape(incomplete)}*/"))
