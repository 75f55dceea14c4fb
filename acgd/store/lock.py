"""One process at a time: the project's lock, across processes, workflows and `acgd gc`."""

import os
import shutil
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

LOOK_EVERY_S = 1.0
"""How often a waiting process looks who holds the lock; it tries to take the lock twenty times as often."""


@contextmanager
def held(path: Path, what: str, wait: bool = True) -> Iterator[bool]:
    """Holds the lock at `path`. Without `wait`, gives False where another process holds it.

    A waiting process names the holder on stderr. The lock is the kernel's (flock): it ends with its holder, however
    that ends, and the file may stay. The holder may remove the folder of the lock (`remove_with_lock`). A process that
    opened the file before would then lock a file that nobody else can open, so a lock counts only if its file is still
    at `path`.

    Processes of several hosts exclude each other where the file system passes flock on (NFS from Linux 2.6.12, Lustre
    mounted with `flock`). Where flock is local to each host, run the workflow on one host at a time. Where the file
    system has none, taking the lock fails with OSError.
    """
    lock = FileLock(path, fallback_to_soft=False, thread_local=False, on_acquired=lambda file: _sign(file, path))
    taken = _take(lock, path, what, wait)
    try:
        yield taken
    finally:
        if taken:
            lock.release()


def remove_with_lock(path: Path) -> None:
    """Removes the folder of the lock at `path`, which the caller holds.

    The lock goes last: with its file gone, the next holder may begin to fill the folder.
    """
    for entry in path.parent.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry, ignore_errors=True)
        elif entry != path:
            entry.unlink(missing_ok=True)
    path.unlink(missing_ok=True)
    try:
        path.parent.rmdir()
    except OSError:  # the next holder's lock is in it
        pass


class _FileGone(Exception):
    """The locked file is no longer at the lock's path."""


def _take(lock: FileLock, path: Path, what: str, wait: bool) -> bool:
    named = None
    timeout_s = 0.0
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=timeout_s)
            return True
        except (FileNotFoundError, FileExistsError, _FileGone):  # the folder was removed in between
            if path.parent.is_file():
                raise
        except Timeout:
            if not wait:
                return False
            timeout_s, holder = LOOK_EVERY_S, _holder(path)
            if holder != named:
                named = holder
                print(f"{what}: waiting for {holder}, which is making it", file=sys.stderr, flush=True)


def _sign(file: int, path: Path) -> None:
    """Writes the holder into the locked file."""
    try:
        there = path.stat()
    except FileNotFoundError:
        raise _FileGone from None
    if not os.path.samestat(os.fstat(file), there):
        raise _FileGone
    os.ftruncate(file, 0)
    os.pwrite(file, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)


def _holder(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip() or "another process"
    except FileNotFoundError:
        return "another process"
