"""Ends of reference runs that studies share: kept in memory by what they are ends of, and in files of a folder that the user names."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

import polyida
from polyida.errors import InputError
from polyida.files import write_file
from polyida.fingerprint import NoFingerprint, fingerprint_of
from polyida.model.guarded import unguarded
from polyida.study.tasks import package_hash
from polyida.validation import path_of

MOST_PROBLEMS = 20  # whose ends stay in memory
_in_memory: dict = {}  # {fingerprint: {name of a run: End}}, the problem that was asked for last at the end


@dataclass
class End:
    """How a reference run ended.

    method: the run in words. values: {part: array}, empty if it failed. missed: {part: possible error from pulses between its stages}. seconds:
    its CPU time. failed: the message of a run that did not reach its end.
    """

    method: str = ""
    values: dict = field(default_factory=dict)
    missed: dict = field(default_factory=dict)
    seconds: float = 0.0
    failed: str = ""


def require_folder(study, folder, name="reference_folder"):
    """The folder of the argument `name` of a study, created if it is missing, or None. Raises InputError if it can be none."""
    if folder is None:
        return None
    folder = path_of(study, name, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{study}: {name} = {str(folder)!r} is none and cannot be made one: {error.strerror}") from None
    return folder


class KeptEnds:
    """{name of a run: End} of one model, start and time.

    A model with a value of which nobody can say whether it changed is not kept beyond the study. folder: of the file, None for none.
    """

    def __init__(self, ivp, folder=None):
        """Find the ends of this problem in memory, by a fingerprint of model, start, time and quantity, and add those of the file."""
        self.path = None  # of the file, None for none
        self.ends = {}  # {name of a run: End}
        try:
            compared = (ivp.quantity.of, ivp.quantity.times) if ivp.quantity else ()
            motion = unguarded(ivp.model), ivp.q0, ivp.v0, float(ivp.t_end), *compared
            mark = fingerprint_of((*motion, polyida.__version__, package_hash()))
        except NoFingerprint:
            return
        self.ends = _in_memory[mark] = _in_memory.pop(mark, {})
        for old in list(_in_memory)[:-MOST_PROBLEMS]:
            del _in_memory[old]
        if folder is not None:
            self.path = Path(folder) / f"{mark[:32]}.json"
            for name, end in _read(self.path).items():
                self.ends.setdefault(name, end)

    def get(self, name):
        """The kept End of a run of that name, or None."""
        return self.ends.get(name)

    def __setitem__(self, name, end):
        """Keep the End of a run under a name, in place of an earlier one, and write all kept Ends to the file, if there is a path.

        Raises InputError if that fails.
        """
        self.ends[name] = end
        if self.path is None:
            return
        plain = {
            key: asdict(one) | {"values": {part: value.tolist() for part, value in one.values.items()}} for key, one in self.ends.items()
        }
        try:
            write_file(self.path, json.dumps(plain))
        except OSError as error:
            raise InputError(f"reference_folder: {self.path} cannot be written: {error.strerror or error}") from error


def _read(path):
    """{name: End} of a file; empty if there is none or it is damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        ends = {name: End(**one) for name, one in data.items()}
        for end in ends.values():
            end.values = {part: np.array(value, float) for part, value in end.values.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
    return ends
