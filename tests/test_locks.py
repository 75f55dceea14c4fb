"""One maker at a time, with real processes: makers, killed makers, and `acgd gc` in between."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from acgd.store.lock import held, remove_with_lock
from acgd.store.store import Store

ROOT = Path(__file__).parents[1]
PLACE = "critic/myo-reach/0123456789abcdef"
IDENTITY = {"version": 1}

MAKER = """
import sys, time
from pathlib import Path
from acgd.store.store import Store
place, results = sys.argv[1:]
def fill(space):
    print("filling", flush=True)
    (space.payload / "a.bin").write_bytes(b"a" * 100)
    while not Path(results, "go").exists():
        time.sleep(0.01)
    return {}
made = Store(Path(results)).make(place, {"version": 1}, fill)
print("made" if made else "found", flush=True)
"""

REPEATED_MAKER = """
import os, sys, time
from pathlib import Path
from acgd.store.store import Store
place, results, seconds = sys.argv[1:]
results = Path(results)
def fill(space):
    os.close(os.open(results / "inside", os.O_CREAT | os.O_EXCL))  # FileExistsError where another maker is inside
    (space.payload / "a.bin").write_bytes(b"a" * 100)
    (space.state / "step").write_text("7")
    time.sleep(0.001)
    assert (space.payload / "a.bin").exists() and (space.state / "step").exists(), "removed while it was made"
    (results / "inside").unlink()
    return {}
made, end = 0, time.monotonic() + float(seconds)
while time.monotonic() < end:
    made += Store(results).make(place, {"version": 1}, fill)
print(made)
"""

HOLDER = """
import sys, time
from pathlib import Path
from acgd.store.lock import held
with held(Path(sys.argv[1]), "it"):
    print("held", flush=True)
    time.sleep(60)
"""


def started(code, *arguments):
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "results")


def test_of_two_makers_one_makes_and_the_other_waits_and_names_the_holder(store):
    first = started(MAKER, PLACE, store.results)
    assert first.stdout.readline() == "filling\n"
    second = started(MAKER, PLACE, store.results)
    assert f"{PLACE}: waiting for process {first.pid} on {socket.gethostname()}" in second.stderr.readline()
    (store.results / "go").touch()
    assert second.communicate(timeout=60)[0] == "found\n"
    assert first.communicate(timeout=60)[0] == "made\n"


def test_the_lock_of_a_killed_maker_holds_nobody_up(store):
    first = started(MAKER, PLACE, store.results)
    first.stdout.readline()
    second = started(MAKER, PLACE, store.results)
    second.stderr.readline()
    first.send_signal(signal.SIGKILL)
    first.communicate(timeout=60)
    (store.results / "go").touch()
    assert second.communicate(timeout=60)[0].split() == ["filling", "made"]


def test_gc_between_two_makers_never_lets_both_make(store):
    makers = [started(REPEATED_MAKER, PLACE, store.results, 4) for _ in range(2)]
    freed = 0
    while any(maker.poll() is None for maker in makers):
        freed += store.free(PLACE)
    outs = [maker.communicate(timeout=60) for maker in makers]
    assert [maker.returncode for maker in makers] == [0, 0], [err[-600:] for _, err in outs]
    assert freed > 50 and all(int(out) > 5 for out, _ in outs)


def test_a_lock_whose_file_is_removed_between_opening_and_locking_is_taken_anew(tmp_path, monkeypatch):
    """As by `acgd gc`: the file that is open would be locked by this process, and the file at the path by the next."""
    import filelock._unix as unix

    path = tmp_path / "work" / "lock"
    lock, removed = unix.lock_fd_nonblocking, []

    def after_gc(file):
        if len(removed) < 2:
            path.unlink()
            removed.append(file)
            if len(removed) == 2:  # another file at the same path, whose link count is that of a lock in use
                path.touch()
        return lock(file)

    monkeypatch.setattr(unix, "lock_fd_nonblocking", after_gc)
    with held(path, "it") as mine:
        assert mine and len(removed) == 2
        assert path.read_text() == f"process {os.getpid()} on {socket.gethostname()}"
        other = started("import sys; from pathlib import Path; from acgd.store.lock import held\n"
                        "with held(Path(sys.argv[1]), 'it', wait=False) as mine: print(mine)", path)  # fmt: skip
        assert other.communicate(timeout=60)[0] == "False\n"


def test_the_folder_of_a_lock_is_removed_lock_last_and_a_waiting_process_gets_the_next(tmp_path):
    path = tmp_path / "work" / "lock"
    with held(path, "it"):
        waiting = started(HOLDER, path)
        assert f"waiting for process {os.getpid()}" in waiting.stderr.readline()
        (path.parent / "state").mkdir()
        (path.parent / "state" / "step").touch()
        remove_with_lock(path)
        assert waiting.stdout.readline() == "held\n"  # this process holds a file that is gone
    with held(path, "it", wait=False) as mine:
        assert not mine
    waiting.kill()
    waiting.communicate(timeout=60)


def test_an_artifact_that_a_process_makes_is_not_freed(store):
    process = started(MAKER, PLACE, store.results)
    process.stdout.readline()
    began = time.monotonic()
    assert not store.free(PLACE) and time.monotonic() - began < 1
    (store.results / "go").touch()
    assert process.communicate(timeout=60)[0] == "made\n" and store.has(PLACE)


def test_removing_waits_for_the_maker(store):
    process = started(MAKER, PLACE, store.results)
    process.stdout.readline()
    remover = started(
        "import sys; from pathlib import Path; from acgd.store.store import Store\n"
        "Store(Path(sys.argv[2])).remove(sys.argv[1])",
        PLACE,
        store.results,
    )
    assert f"waiting for process {process.pid}" in remover.stderr.readline()
    (store.results / "go").touch()
    assert process.communicate(timeout=60)[0] == "made\n"
    assert remover.wait(timeout=60) == 0 and not store.has(PLACE)
