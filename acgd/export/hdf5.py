"""Arrays in HDF5, compressed in a way that every reader of HDF5 understands."""

import h5py
import numpy as np

ROWS_PER_CHUNK = 16
"""Of images, which are read one by one."""


def put(group: h5py.Group, name: str, value: np.ndarray) -> None:
    """Images are compressed; narrower arrays, which hardly shrink, are not."""
    if value.ndim == 4:
        chunks = (min(len(value), ROWS_PER_CHUNK), *value.shape[1:])
        group.create_dataset(name, data=value, chunks=chunks, compression="gzip", compression_opts=1, shuffle=False)
    else:
        group.create_dataset(name, data=value)
