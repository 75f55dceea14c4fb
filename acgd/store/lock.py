"""One maker at a time for each artifact, across processes and workflows."""

import fcntl
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def held(path: Path, what: str, wait: bool = True) -> Iterator[bool]:
    """Holds the lock at `path`; says so where it has to wait. Without `wait`, gives False where another holds it.

    The kernel lets go of the lock when its holder ends, however it ends.
    """
    file = _open(path)
    try:
        while not _taken(file):
            if not wait:
                yield False
                return
            holder = os.pread(file, 200, 0).decode(errors="replace").strip()
            print(f"{what}: waiting for {holder or 'another process'}, which is making it", file=sys.stderr, flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
            if not _is_at(file, path):  # gc has taken the file away: whoever comes next would lock another one
                os.close(file)
                file = _open(path)
        os.ftruncate(file, 0)
        os.pwrite(file, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
        yield True
    finally:
        os.close(file)


def _taken(file: int) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.fstat(file).st_ino == path.stat().st_ino
    except FileNotFoundError:
        return False


def _open(path: Path) -> int:
    path.parent.mkdir(parents=True, exist_ok=True)
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
