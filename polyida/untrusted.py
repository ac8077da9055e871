"""Reading of HDF5 files that nobody vouches for: plain numbers only, and not more of them than the file can hold."""

import json
import os
import struct
import zlib

import numpy as np

from polyida.errors import InputError
from polyida.file_lock import being_written
from polyida.unclosed import LENGTH, Unclosed, is_marked


def opened(path):
    """The file opened for reading, also while it is written or after its writer was killed. Raises OSError."""
    import h5py

    if being_written(path):
        return h5py.File(path, "r", libver="latest", swmr=True, locking=False)
    with open(path, "rb") as file:
        marked = is_marked(file.read(LENGTH))
    return h5py.File(Unclosed(path), "r") if marked else h5py.File(path, "r", locking=False)


class Reader:
    """Datasets of an open file, checked before they are read, together not more than the size of the file.

    No links to other files, no virtual, external or compressed datasets, no numbers but integers and floats.
    Raises InputError naming the dataset.
    """

    def __init__(self, file, path):
        self.file = file
        self.size = self.budget = os.path.getsize(path)

    def has(self, name):
        """Whether the file's top level holds something of that name."""
        return name in self.file

    def dataset(self, name, shape):
        """The dataset of that name, not read; `shape` has None where any length is right."""
        import h5py

        if not isinstance(self.file.get(name, getlink=True), h5py.HardLink):
            raise InputError(f"{name} is not in the file")
        return self._checked(name, self.file[name], shape)

    def array(self, name, shape):
        """A dataset read whole: finite float64, int64, or bytes."""
        return self._read(name, self.dataset(name, shape))

    def text(self, name):
        """What the JSON in a dataset of bytes says."""
        return json.loads(self.array(name, (None,)).astype(np.uint8).tobytes())

    def record(self, name):
        """What the JSON in a slot says, or None where the slot is empty or was not written to its end."""
        stored = self.array(name, (None,)).astype(np.uint8).tobytes()
        if len(stored) < 8:
            return None
        length, check = struct.unpack("<II", stored[:8])
        text = stored[8 : 8 + length]
        return json.loads(text) if len(text) == length and zlib.crc32(text) == check else None

    def group(self, name):
        """{path in the group: array} of a group that may be missing."""
        import h5py

        if not self.has(name):
            return {}
        if not (
            isinstance(self.file.get(name, getlink=True), h5py.HardLink) and isinstance(self.file[name], h5py.Group)
        ):
            raise InputError(f"{name} is no group of the file")
        found = {}
        self.file[name].visititems(
            lambda key, node: found.update({key: node}) if isinstance(node, h5py.Dataset) else None
        )
        return {key: self._read(key, self._checked(key, node, None)) for key, node in found.items()}

    def _checked(self, name, node, shape):
        import h5py

        if not isinstance(node, h5py.Dataset) or node.dtype.kind not in "fiu" or node.shape is None:
            raise InputError(f"{name} does not hold numbers")
        if shape is not None and (
            len(shape) != node.ndim or any(b not in (None, a) for a, b in zip(node.shape, shape))
        ):
            raise InputError(f"{name} has the shape {node.shape}; {shape} is needed")
        if node.is_virtual or node.external or node.id.get_create_plist().get_nfilters():
            raise InputError(f"{name} is virtual, external or compressed")
        if node.nbytes > self.size:
            raise InputError(f"{name} claims {node.nbytes} bytes, the file has {self.size}")
        return node

    def _read(self, name, node):
        self.budget -= node.nbytes
        if self.budget < 0:
            raise InputError(f"{name}: the arrays claim more than the {self.size} bytes of the file")
        values = np.asarray(node[()])
        if values.dtype != np.uint8:
            values = values.astype(np.float64 if values.dtype.kind == "f" else np.int64)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{name} holds values that are not finite")
        return values
