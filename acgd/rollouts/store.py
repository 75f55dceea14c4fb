"""Arrays of episodes in zarr 3: compressed, with checksums, and with equal bytes for equal content.

zarr reads a missing chunk as zeros without an error. The attributes of a group therefore hold the number of chunks of
each array, and reading compares it with the files.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import ZstdCodec

FRAMES_PER_CHUNK = 64
"""Rows of a chunk of images. A chunk of another array has as many rows as fit in CHUNK_BYTES."""
CHUNK_BYTES = 1 << 20


class DamagedStoreError(RuntimeError):
    """A part of the store is missing or unreadable. The message names the file and the mend."""


def write_group(path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> None:
    """Writes `arrays` (names may contain slashes) and `attributes` as a zarr group at `path`, which must not exist."""
    group = zarr.open_group(path, mode="w-", zarr_format=3)
    chunks = {}
    for name in sorted(arrays):
        value = np.ascontiguousarray(arrays[name])
        array = group.create_array(
            name,
            shape=value.shape,
            dtype=value.dtype,
            chunks=(_rows_per_chunk(value), *(max(1, n) for n in value.shape[1:])),
            compressors=[ZstdCodec(level=3, checksum=True)],
            fill_value=0,
            config={"write_empty_chunks": True},
        )
        array[...] = value
        chunks[name] = sum(1 for _ in _chunk_files(path, array))
    group.attrs.put({**attributes, "chunks": chunks})


def read_attributes(path: Path) -> dict[str, Any]:
    """The attributes of `write_group`, and `chunks`: array name -> number of chunk files. DamagedStoreError."""
    try:
        return dict(zarr.open_group(path, mode="r").attrs)
    except Exception as error:
        raise _damaged(path / "zarr.json", "cannot be read") from error


def read_group(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The named arrays, decoded into memory.

    DamagedStoreError where a chunk of any array of the group is missing, or a named array does not decode. KeyError for
    a name that is not in the group.
    """
    chunks = read_attributes(path)["chunks"]
    unknown = [name for name in names if name not in chunks]
    if unknown:
        raise KeyError(f"{path} has no array {unknown[0]!r}; it has {', '.join(chunks)}")
    opened = {name: _open(path, name) for name in chunks}
    for name, array in opened.items():
        files = list(_chunk_files(path, array))
        if len(files) != chunks[name]:
            raise _damaged(path / name / "zarr.json", f"speaks of {len(files)} chunks, {chunks[name]} were written")
        for file in files:
            if not file.is_file():
                raise _damaged(file, "is missing")
    return {name: _decode(path, opened[name]) for name in names}


def read_rows(path: Path, name: str, start: int, stop: int) -> np.ndarray:
    """Rows `start` to `stop` of one array, for those who cannot hold all of it. DamagedStoreError as above."""
    array = _open(path, name)
    for file in _chunk_files(path, array):
        if not file.is_file():
            raise _damaged(file, "is missing")
    try:
        return np.asarray(array[start:stop])
    except Exception as error:
        raise _damaged(_first_unreadable(path, array), "does not decode") from error


def _rows_per_chunk(value: np.ndarray) -> int:
    if value.ndim == 4:
        return FRAMES_PER_CHUNK
    row = max(1, value.itemsize * int(np.prod(value.shape[1:], dtype=np.int64)))
    return max(1, CHUNK_BYTES // row)


def _chunk_files(path: Path, array: zarr.Array) -> Iterator[Path]:
    """Chunk files of an array, in order."""
    grid = (range(-(-n // c)) for n, c in zip(array.shape, array.chunks))
    for coordinate in product(*grid):
        yield path / array.path / "c" / "/".join(map(str, coordinate))


def _open(path: Path, name: str) -> zarr.Array:
    try:
        return zarr.open_group(path, mode="r")[name]
    except Exception as error:
        raise _damaged(path / name / "zarr.json", "cannot be read") from error


def _decode(path: Path, array: zarr.Array) -> np.ndarray:
    try:
        return np.asarray(array[...])
    except Exception as error:
        raise _damaged(_first_unreadable(path, array), "does not decode") from error


def _first_unreadable(path: Path, array: zarr.Array) -> Path:
    for index, file in enumerate(_chunk_files(path, array)):
        try:
            array.blocks[index]
        except Exception:
            return file
    return path / array.path


def _damaged(file: Path, what: str) -> DamagedStoreError:
    return DamagedStoreError(
        f"{file} {what}: the artifact is damaged. Delete its directory and run the same command again: it is made anew."
    )
