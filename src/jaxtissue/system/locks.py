"""Locks for folders: one process at a time, or several that share a folder. A lock ends with its process."""

import contextlib
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxtissue.system.files import check_folder, remove_leftovers

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

NAME = ".lock"
WAIT = 20.0  # seconds: a process that shares a folder prepares it in less
_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)


class Lock:
    """A file that processes lock; it is there as long as one does, or one was killed.

    Where there are no locks, as on some network disks, a warning tells so, and all may take it.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.works = path, fcntl is not None
        self._open()

    def _open(self) -> None:
        try:
            self._file = os.open(self.path, _FLAGS, 0o666)
        except OSError as error:
            raise ValueError(f"the lock file {self.path} cannot be opened ({error.strerror}); remove it") from error

    def take(self, shared: bool = False) -> bool:
        """Take the lock, alone or with others; whether that was possible."""
        if not (fcntl and self.works):
            return True
        try:
            while True:
                fcntl.flock(self._file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
                if self._is_there():
                    break
                os.close(self._file)  # the last holder removed it meanwhile
                self._open()
        except BlockingIOError:
            return False
        except OSError as error:
            self.works = False
            told = f"the folder {self.path.parent} cannot be locked ({error.strerror})"
            warnings.warn(f"{told}; do not start another command in this folder until this one has ended", stacklevel=2)
            return True
        if not shared:
            os.truncate(self._file, 0)
            os.pwrite(self._file, f"process {os.getpid()} on {platform.node()}".encode(), 0)
        return True

    def holder(self) -> str:
        """The process that last took the lock alone."""
        return os.pread(self._file, 200, 0).decode(errors="replace") or "another process"

    def release(self) -> None:
        """Let others take it; the last one removes it."""
        if self.works and self.take():
            self.path.unlink(missing_ok=True)
        os.close(self._file)

    def _is_there(self) -> bool:
        with contextlib.suppress(FileNotFoundError):
            return os.path.samestat(os.stat(self.path), os.fstat(self._file))
        return False


@contextmanager
def alone(folder: Path, name: str = NAME, what: str = "a run") -> Iterator[None]:
    """Hold a folder, which is made if need be, for this process alone; what was half written is removed.

    A folder that was made and is empty in the end is removed. Raises `ValueError` where another holds it.
    """
    with _made(folder):
        lock = Lock(folder / name)
        if not lock.take():
            holder = lock.holder()
            os.close(lock._file)
            raise ValueError(
                f"{what} is still in progress in {folder} ({holder}); wait until it has ended, or choose another folder"
            )
        try:
            if lock.works and name == NAME:
                remove_leftovers(folder)
            yield
        finally:
            lock.release()


@contextmanager
def together(folder: Path, prepare: Callable[[bool | None], None]) -> Iterator[None]:
    """Share a folder, which is made if need be, with other processes that share it.

    `prepare(alone)` is called first; it is told whether no other process shares the folder by then, None
    where there are no locks. Raises `ValueError` where one holds it alone.
    """
    with _made(folder):
        lock, ends = Lock(folder / NAME), time.monotonic() + WAIT
        is_alone = lock.take()

        def share() -> None:
            while not lock.take(shared=True):
                if time.monotonic() > ends:
                    told = f"{folder} is in use by {lock.holder()}"
                    raise ValueError(f"{told}; wait until it has ended, or choose another folder")
                time.sleep(0.05)

        try:
            if not is_alone:
                share()
            prepare(is_alone if lock.works else None)
            if is_alone:
                share()
            yield
        finally:
            lock.release()


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make a folder with those above it; what of these is empty in the end is removed."""
    check_folder(folder, force=True)
    new = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        message = f"the output folder {folder} is not writable ({error.strerror}); choose another"
        raise ValueError(message) from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            for place in new:
                place.rmdir()
