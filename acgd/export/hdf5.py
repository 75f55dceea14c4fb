"""Arrays in HDF5, with a compression that every reader of HDF5 knows."""

import h5py
import numpy as np

ROWS_PER_CHUNK = 16
"""Images in a chunk. Few, since readers read images one by one."""


def put(group: h5py.Group, name: str, value: np.ndarray) -> None:
    """Writes an array. Images are compressed; other arrays are not, since they hardly shrink."""
    if value.ndim == 4:
        chunks = (min(len(value), ROWS_PER_CHUNK), *value.shape[1:])
        group.create_dataset(name, data=value, chunks=chunks, compression="gzip", compression_opts=1, shuffle=False)
    else:
        group.create_dataset(name, data=value)
