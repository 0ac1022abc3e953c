"""Files that are written completely or not at all, with checksums, and never through links."""

import contextlib
import hashlib
import io
import json
import math
import os
import platform
import re
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from jaxtissue.system.signals import BEING_WRITTEN

_LEFTOVER = re.compile(r"\.(.+\.)?(part|lock)")  # of processes that were killed, unless they still run
_SEALED = re.compile(rb'(.*),\n  "checksum": "([0-9a-f]{64})"\n}\n', re.DOTALL)
_DIGITS = 64  # of a SHA-256
_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)


def check_folder(folder: Path, force: bool) -> None:
    """Raise `ValueError` where a folder holds files (unless forced) or can't be written; touch nothing."""
    try:
        if folder.exists() and not (folder.is_dir() and (force or is_empty(folder))):
            problem = "is not empty; choose another or add --force" if folder.is_dir() else "is a file; choose another"
            raise ValueError(f"the output folder {folder} {problem}")
        nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
        writable = nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)
    except OSError:
        writable = False
    if not writable:
        raise ValueError(f"the output folder {folder} is not writable; choose another")


def is_empty(folder: Path) -> bool:
    """Whether a folder holds nothing but what a killed process left."""
    return all(_LEFTOVER.fullmatch(path.name) for path in folder.iterdir())


def make_folder(folder: Path, outdated: Sequence[str] = ()) -> None:
    """Make a folder, or remove the `outdated` files of one that exists."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in outdated:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        message = f"the output folder {folder} is not writable ({error.strerror}); choose another"
        raise ValueError(message) from error


def refuse_link(path: Path) -> None:
    """Raise `ValueError` for a link."""
    if path.is_symlink():
        raise ValueError(f"{path} is a symbolic link, and jaxtissue does not follow links; remove it")


def make_subfolder(folder: Path) -> None:
    """Make a folder within an output folder. Raises `ValueError` where a link stands in its place."""
    refuse_link(folder)
    make_folder(folder)


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes began to write in a folder; none may be at work there."""
    for path in list(folder.iterdir()) if folder.is_dir() else []:
        if path.name.endswith(".part") and _LEFTOVER.fullmatch(path.name):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


@contextmanager
def replacing(path: Path, mode: str) -> Iterator[IO[Any]]:
    """Open ("w" or "wb") a file that takes the place of `path` when it is complete and on the disk."""
    # processes on several machines may write to one folder
    temporary = path.with_name(f".{path.name}.{platform.node()}-{os.getpid()}.part")
    temporary.unlink(missing_ok=True)
    try:
        BEING_WRITTEN.add(temporary)
        with open_own(temporary, mode, os.O_CREAT | os.O_EXCL) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:  # a full disk does not say where
            raise OSError(f"{error}, while writing {path}") from error
        raise
    finally:
        BEING_WRITTEN.discard(temporary)


def open_own(path: Path, mode: str, flags: int = 0) -> IO[Any]:
    """Open a file of this process's own, text in UTF-8; not the file that a link in its place leads to.

    Raises `ValueError` for a link.
    """
    refuse_link(path)
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")

    def opener(name: str, usual: int) -> int:
        return os.open(name, usual | flags | _NO_LINKS, 0o666)

    return open(path, mode, encoding=encoding, newline=newline, opener=opener)


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as JSON; what is infinite or not a number becomes null."""
    with replacing(path, "w") as file:
        file.write(_json(values) + "\n")


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write values, at least one, as `write_json`, and last the `checksum` of all before it."""
    body = _json(values).removesuffix("\n}")
    with replacing(path, "w") as file:
        file.write(f'{body},\n  "checksum": "{hashlib.sha256(body.encode()).hexdigest()}"\n}}\n')


def read_sealed(path: Path, remedy: str) -> dict[str, Any]:
    """The values that `write_sealed` wrote. Raises `ValueError`, with the remedy, where a bit has changed."""
    try:
        found = _SEALED.fullmatch(path.read_bytes())
        if not found or hashlib.sha256(found[1]).hexdigest().encode() != found[2]:
            raise ValueError("its checksum does not match its content")
        return json.loads(found[1] + b"}")
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} is damaged ({_told(error)}); {remedy}") from error


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(_plain(values), indent=2, allow_nan=False)  # ASCII, for names that are not UTF-8


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, str | None):
        return value
    number = np.asarray(value).item()
    return None if isinstance(number, float) and not math.isfinite(number) else number


def save_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays as npz with their checksum as the archive's comment.

    At any moment `path` holds a whole file, the old or the new.
    """
    whole = io.BytesIO()
    np.savez(whole, allow_pickle=False, **arrays)
    # an archive ends with the length of its comment, in two bytes, and the comment
    body = whole.getvalue()[:-2] + _DIGITS.to_bytes(2, "little")
    with replacing(path, "wb") as file:
        file.write(body + hashlib.sha256(body).hexdigest().encode())


def load_arrays(path: Path, remedy: str) -> dict[str, np.ndarray]:
    """The arrays that `save_arrays` wrote. Raises `ValueError`, with the remedy, where a bit has changed."""
    try:
        whole = path.read_bytes()
        if hashlib.sha256(whole[:-_DIGITS]).hexdigest().encode() != whole[-_DIGITS:]:
            raise ValueError("its checksum does not match its content")
        with np.load(io.BytesIO(whole), allow_pickle=False) as file:
            return dict(file)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is damaged ({_told(error)}); {remedy}") from error


def checksum(path: Path) -> str:
    """SHA-256 of a file; empty where it can't be read."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def check_files(folder: Path, checksums: Mapping[str, str], remedy: str) -> None:
    """Raise `ValueError`, with the remedy, for the first file that is not as its checksum says."""
    for name, expected in checksums.items():
        if (found := checksum(folder / name)) != expected:
            problem = "its checksum does not match its content" if found else "it can't be read"
            raise ValueError(f"{folder / name} is damaged ({problem}); {remedy}")


def _told(error: Exception) -> str:
    """The reason of an error, without the name of the file."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
