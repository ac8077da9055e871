"""Datasets of an HDF5 file that nobody vouches for: plain numbers only, and not more of them than the file can hold."""

import numpy as np

from polyida.errors import InputError
from polyida.io.layout import BLOCK_BYTES


class Checked:
    """Datasets of an open file, checked before they are read, together not more than the `size` of the file.

    No links to other files, no virtual, external or compressed datasets, no numbers but integers and floats.
    `shape` has None where any length is right. Raises InputError naming the dataset.
    """

    def __init__(self, file, size):
        self.file, self.size, self._budget = file, size, size

    def array(self, name, shape):
        """A dataset read whole: finite float64, int64, or bytes."""
        return self._read(name, self.dataset(name, shape))

    def group(self, name):
        """{path in the group: array} of a group that may be missing."""
        import h5py

        if name not in self.file:
            return {}
        node = self.file[name] if isinstance(self.file.get(name, getlink=True), h5py.HardLink) else None
        if not isinstance(node, h5py.Group):
            raise InputError(f"{name} is no group of the file")
        found = {}
        node.visititems(lambda key, node: found.update({key: node}) if isinstance(node, h5py.Dataset) else None)
        return {key: self._read(f"{name}/{key}", self._checked(key, node, None)) for key, node in found.items()}

    def dataset(self, name, shape):
        """The dataset of that name, not read."""
        import h5py

        if not isinstance(self.file.get(name, getlink=True), h5py.HardLink):
            raise InputError(f"{name} is not in the file")
        return self._checked(name, self.file[name], shape)

    def _checked(self, name, node, shape):
        import h5py

        if not isinstance(node, h5py.Dataset) or node.dtype.kind not in "fiu" or node.shape is None:
            raise InputError(f"{name} does not hold numbers")
        if shape is not None and (
            len(shape) != node.ndim or any(b not in (None, a) for a, b in zip(node.shape, shape))
        ):
            raise InputError(f"{name} has the shape {node.shape}; {shape} is needed")
        filters = node.id.get_create_plist()
        kinds = {filters.get_filter(k)[0] for k in range(filters.get_nfilters())}
        if node.is_virtual or node.external or kinds - {h5py.h5z.FILTER_FLETCHER32}:
            raise InputError(f"{name} is virtual, external or compressed")
        chunk = node.dtype.itemsize * int(np.prod(node.chunks or (0,), dtype=object))
        if node.nbytes > self.size or chunk > 2 * self.size + BLOCK_BYTES:
            raise InputError(f"{name} claims {max(node.nbytes, chunk)} bytes, the file has {self.size}")
        return node

    def _read(self, name, node):
        self._budget -= node.nbytes
        if self._budget < 0:
            raise InputError(f"{name}: the arrays claim more than the {self.size} bytes of the file")
        try:
            values = np.asarray(node[()])
        except OSError as error:
            raise InputError(f"{name} is damaged ({error})") from None
        if values.dtype != np.uint8:
            values = values.astype(np.float64 if values.dtype.kind == "f" else np.int64)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{name} holds values that are not finite")
        return values
