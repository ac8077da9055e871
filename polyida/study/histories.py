"""Histories of several runs as one data set: each has times of its own."""

import numpy as np

from polyida.errors import InputError


def dataset(histories):
    """{label: {"t": (frames,), name: (frames,)}} as an xarray.Dataset over (run, frame), t a coordinate, NaN behind a run's last frame.

    Raises InputError where xarray is not installed.
    """
    try:
        from xarray import Dataset
    except ImportError:
        raise InputError("to_xarray: xarray is not installed; pip install 'polyida[xarray]'") from None
    names = list(dict.fromkeys(name for found in histories.values() for name in found if name != "t"))
    count = max(len(found["t"]) for found in histories.values())
    columns = {
        name: (["run", "frame"], np.array([_padded(found.get(name), count) for found in histories.values()])) for name in ["t", *names]
    }
    return Dataset(columns, coords={"run": list(histories)}).set_coords("t")


def _padded(values, count):
    full = np.full(count, np.nan)
    if values is not None:
        full[: len(values)] = values
    return full
