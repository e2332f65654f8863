"""Files that appear whole or not at all: written beside their place, then moved into it."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

UNFINISHED = ".unfinished."
"""How the names of files and folders begin that are not whole yet."""
MARK = ".skipnet"
"""The file by which a run owns its folder; it names the command."""
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path with the same suffix; move it to ``path`` if the block succeeds.

    The folder is made when missing. After an error the temporary file is gone
    and ``path`` is as it was; errors of the system name ``path``.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = f"{UNFINISHED}{path.stem}."
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        with naming(path):
            yield temporary
        # mkstemp makes files that only their owner may read; a result is a file like any other.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def owned(folder: Path, by: str) -> Iterator[None]:
    """Let a run have a folder to itself from its beginning to its end, however that comes.

    The system lets go of the folder when the process ends, so a killed run blocks no other. What
    such a run left half written is removed; a folder that the run made and left empty, too.

    Args:
        folder: made when missing.
        by: the command; a folder belongs to the one that wrote into it first.

    Raises:
        ValueError: another run has the folder now, or it belongs to another command.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    mark = folder / MARK
    handle = _hold(mark)
    try:
        owner = mark.read_text(encoding="utf-8", errors="replace").strip()[:40]
        if owner not in ("", by):
            raise ValueError(
                f"{folder}: holds a run of skipnet {owner}: choose another output_dir for {by}"
            )
        if not owner:
            with naming(mark):
                mark.write_text(f"{by}\n", encoding="utf-8")
        _clear(folder)
        yield
    finally:
        if made and [path.name for path in folder.iterdir()] == [MARK]:
            mark.unlink()
            with suppress(OSError):  # of a folder above that others use by now
                for path in made:
                    path.rmdir()
        os.close(handle)


def _hold(mark: Path) -> int:
    """An open file that is locked until it is closed; nobody else holds one of the same path."""
    import fcntl

    while True:
        mark.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(mark, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if mark.exists() and os.path.samestat(os.fstat(handle), mark.stat()):
                return handle
        except BlockingIOError as error:
            os.close(handle)
            raise ValueError(
                f"{mark.parent}: another run writes into it now: wait for its end, or choose "
                "another output_dir"
            ) from error
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return handle  # some network folders know no locks
            raise
        os.close(handle)  # whoever held it before removed it with its folder


def _clear(folder: Path) -> None:
    """Remove what a killed run left half written, up to two folders below, other runs' excepted."""
    for below in ("", "*/", "*/*/"):
        for left in folder.glob(f"{below}{UNFINISHED}*"):
            between = list(left.parents)[: below.count("/")]
            if any((parent / MARK).exists() for parent in between):
                continue
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left)
            else:
                left.unlink(missing_ok=True)


@contextmanager
def naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Let errors of the system name the file, as of a disk that is full, where they do not."""
    try:
        yield
    except OSError as error:
        says_all = error.errno is None and type(error) is not OSError  # one of ours
        if error.filename is not None or says_all:
            raise
        # NumPy's own has neither number nor words.
        number = error.errno or errno.EIO
        words = error.strerror or f"not written in full, is there room? ({error})"
        raise OSError(number, words, str(path)) from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_config(config: object, path: Path) -> None:
    """The full configuration of a run, a dataclass, defaults included, as YAML."""
    from omegaconf import OmegaConf

    write_text(path, OmegaConf.to_yaml(OmegaConf.structured(config)))


def append_line(path: Path, entry: Mapping[str, Any]) -> None:
    """Add one JSON line and put it on the disk, so that a killed run keeps all it had."""
    with naming(path), path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> list[str]:
    """The lines of a file that grows line by line; none when there is no such file.

    A last line that was cut off by a kill is cut from the file: what it told is done again.
    """
    if not path.exists():
        return []
    content = path.read_bytes()
    complete = content[: content.rfind(b"\n") + 1]
    if len(complete) < len(content):
        os.truncate(path, len(complete))
    try:
        return complete.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: damaged: {error}") from error


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file, which may come from anywhere.

    Raises:
        FileNotFoundError: no such file.
        ValueError: it is damaged, or holds something else.
    """
    return parsed(path.read_bytes(), str(path))


def parsed(text: bytes | str, what: str) -> dict[str, Any]:
    """The object that a JSON text is; ``what`` it is stands in the error.

    >>> parsed('[1, 2]', "a.json")
    Traceback (most recent call last):
    ...
    ValueError: a.json: expected a JSON object, got list
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{what}: damaged, or no JSON: {str(error)[:160]}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{what}: expected a JSON object, got {type(content).__name__}")
    return content


def is_inside(name: str) -> bool:
    """Whether a relative path, as a file of a stranger names it, stays in its folder.

    >>> [is_inside(name) for name in ("a/b.ply", "../b.ply", "/b.ply")]
    [True, False, False]
    """
    path = Path(name)
    return not path.is_absolute() and ".." not in path.parts and "\0" not in name


def plain(value: Any) -> Any:
    """Values as JSON knows them: arrays as lists, NaN and infinity as null, the rest as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
