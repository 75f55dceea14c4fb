"""The project's lock. It excludes other processes, other workflows and `acgd gc`."""

import os
import shutil
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

READ_HOLDER_EVERY_S = 1.0
"""Interval at which a waiting process reads the holder's name. It tries to take the lock twenty times as often."""


@contextmanager
def held(path: Path, what: str, wait: bool = True) -> Iterator[bool]:
    """Holds the lock at `path`. Yields True; without `wait`, yields False at once where another process holds it.

    A waiting process prints `what` and the holder to stderr. The lock is a kernel lock (flock): it ends when the
    holding process ends, for whatever reason, and the lock file may stay. The holder may remove the lock's folder
    (`remove_with_lock`). A process that opened the file before the removal would lock a file that no other process can
    open. A lock therefore counts only if the locked file is still at `path`.

    Processes on several hosts exclude each other where the file system supports flock across hosts (NFS from Linux
    2.6.12, Lustre mounted with `flock`). Where flock is local to a host, run the workflow on one host at a time.
    Raises OSError where the file system has no flock.
    """
    lock = FileLock(path, fallback_to_soft=False, thread_local=False, on_acquired=lambda file: _sign(file, path))
    taken = _take(lock, path, what, wait)
    try:
        yield taken
    finally:
        if taken:
            lock.release()


def remove_with_lock(path: Path) -> None:
    """Removes the folder of the lock at `path`. The caller holds the lock.

    The lock file is removed last: after that the next holder may begin to fill the folder.
    """
    for entry in path.parent.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        elif entry != path:
            entry.unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    try:
        path.parent.rmdir()
    except OSError:  # the folder contains the next holder's lock
        pass


class _FileGone(Exception):
    """The locked file is no longer at the lock's path."""


def _take(lock: FileLock, path: Path, what: str, wait: bool) -> bool:
    """Acquires the lock. Returns False where another process holds it and `wait` is false."""
    printed_holder = None
    timeout_s = 0.0
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=timeout_s)
            return True
        except (FileNotFoundError, FileExistsError, _FileGone):  # another process has removed the folder
            if path.parent.is_file():
                raise
        except Timeout:
            if not wait:
                return False
            timeout_s, holder = READ_HOLDER_EVERY_S, _holder(path)
            if holder != printed_holder:
                printed_holder = holder
                print(f"{what}: waiting for {holder}, which is making it", file=sys.stderr, flush=True)


def _sign(file: int, path: Path) -> None:
    """Writes this process's id and host into the locked file. Raises _FileGone if `path` is another file or absent."""
    try:
        current = path.stat()
    except FileNotFoundError:
        raise _FileGone from None
    if not os.path.samestat(os.fstat(file), current):
        raise _FileGone
    os.ftruncate(file, 0)
    os.pwrite(file, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)


def _holder(path: Path) -> str:
    """The holder as `_sign` wrote it."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or "another process"
    except FileNotFoundError:
        return "another process"
