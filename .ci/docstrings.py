"""Check the docstrings of public functions and classes with numpydoc. Print each finding; exit 1 if there is one."""

import inspect
import sys
from types import ModuleType

from numpydoc.validate import validate

import polyida as pi

CHECKED = {"SS01", "PR01", "PR02", "PR03", "PR10", "RT01", "RT03", "GL06", "GL07", "YD01"}  # codes of numpydoc.validate


def public_names():
    """Dotted names of all public functions and classes."""
    for name in pi.__all__:
        thing = getattr(pi, name)
        public = [entry for entry in dir(thing) if entry[0] != "_"] if isinstance(thing, ModuleType) else []
        for dotted, value in [(f"{name}.{entry}", getattr(thing, entry)) for entry in public] or [(name, thing)]:
            if getattr(value, "__module__", "").startswith("polyida") and (inspect.isclass(value) or inspect.isroutine(value)):
                yield f"polyida.{dotted}"


findings = [f"{name}: {code} {text}" for name in sorted(public_names()) for code, text in validate(name)["errors"] if code in CHECKED]
print("\n".join([*findings, f"{len(findings)} findings"]))
sys.exit(bool(findings))
