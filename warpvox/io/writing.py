"""Atomic writing of files, and error messages for full or failing disks.

A file is written beside its final name, flushed to the disk and then renamed, so that a crash of the process, of the
machine or of the disk's space leaves either the old file or the new one. What a killed process has left beside it bears
:data:`MARK` in its name and is removed by :func:`sweep`.
"""

import csv
import dataclasses
import errno
import io
import json
import math
import os
import secrets
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from warpvox.code import Code
from warpvox.errors import RunError, StorageError, listing
from warpvox.system import flush_to_disk, path_lock

MARK = ".part-"
"""Prefix of the names of temporary files."""

ADVICE = {
    errno.ENOSPC: "no space is left on its disk; free some, or use a folder on another disk",
    errno.EDQUOT: "your quota on its disk is used up; free some space, or use a folder on another disk",
    errno.EFBIG: "it would be larger than files may be there; raise the limit (ulimit -f), or use another disk",
    errno.EROFS: "its disk is read-only; use a folder that can be written to",
    errno.EACCES: "permission is denied; use a folder that you may write to",
    errno.EPERM: "the system does not permit it; use a folder that you may write to",
    errno.ENOENT: "its folder is gone; it has been removed or renamed, or its disk detached",
    errno.ENOTDIR: "a file stands where its folder should be; move that file away, or use another folder",
    errno.EIO: "the disk has failed (input/output error); use another disk",
}
"""Advice for each error of a disk, by errno."""
OF_DISKS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}
"""Error numbers that mean a disk is full, read-only or failing."""
LOGGERS = {"wandb"}
"""Folders that loggers create in a run's folder."""


@contextmanager
def atomic_path(path: str | os.PathLike[str], make_folders: bool = True, follow: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, and rename it to ``path`` if the block ends without an error.

    If the block raises (an interrupt included), the temporary file is removed and whatever stood at ``path`` before
    stays as it was. The temporary name keeps the suffix, by which some writers choose their format.

    Args:
        make_folders: make missing parent folders; False: they should be there, and it is an error if they have gone.
        follow: of a symbolic link, replace the file that it leads to: for a file that the user has named. False: the
            link itself is replaced, so that what is written into a folder lies there.

    Raises:
        StorageError: the disk is full, read-only or gone, or the path is not UTF-8.
    """
    check_encodable(path)
    target = Path(os.path.realpath(path) if follow else os.path.abspath(path))
    with writing(path):
        if make_folders:
            target.parent.mkdir(parents=True, exist_ok=True)
        # Named before it is made: an interrupt that comes with the making finds the name, and removes the file.
        temporary = target.with_name(f"{MARK}{target.stem}-{secrets.token_hex(4)}{target.suffix}")
        try:
            temporary.touch(exist_ok=False)
            with path_lock(temporary):  # until it has its name: sweep() leaves it alone
                yield temporary
                # Without this a power failure may keep the new name and lose what was written under it.
                flush_to_disk(temporary)
                os.replace(temporary, target)
            flush_to_disk(target.parent)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


def check_suffix(what: str, path: str | os.PathLike[str], suffixes: Sequence[str], error: type[Exception]) -> str:
    """Return the lower-case suffix of ``path``; raise ``error`` unless it is one of ``suffixes``.

    Args:
        what: subject of the sentence, such as "The file of a GIF".
        suffixes: those that the writer has a format for, in lower case.

    Raises:
        error: another suffix, or none; the message lists those that are valid.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes:
        raise error(f"{what} must end in {listing(suffixes)}, got '{path}'.")
    return suffix


def write_bytes(
    path: str | os.PathLike[str], data: bytes | memoryview, make_folders: bool = True, follow: bool = False
) -> None:
    """Write ``data`` to ``path`` atomically; see :func:`atomic_path`."""
    with atomic_path(path, make_folders, follow) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | os.PathLike[str], text: str, make_folders: bool = True, follow: bool = False) -> None:
    """Write ``text`` (UTF-8) to ``path`` atomically; see :func:`atomic_path`."""
    write_bytes(path, text.encode("utf-8"), make_folders, follow)


def write_table(path: str | os.PathLike[str], columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Write rows as a CSV file atomically; None is an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([columns, *rows])
    write_text(path, text.getvalue())


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Convert disk errors within the block to a StorageError that names ``path``."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        raise StorageError(f"{path} cannot be written: {complaint(error)}.", error) from error


def complaint(error: OSError) -> str:
    """Describe a disk error and what to do about it, as the end of a sentence."""
    return ADVICE.get(error.errno or 0) or error.strerror or str(error) or type(error).__name__


def check_folder(folder: Path) -> None:
    """Raise StorageError if ``folder`` has vanished, so that no second one is created in its place."""
    if not folder.is_dir():
        raise StorageError(f"The folder {folder} has vanished: was it removed or renamed, or its disk detached?")


def check_encodable(path: str | os.PathLike[str]) -> None:
    """Raise StorageError if a path is no valid UTF-8, which TensorBoard, USD and others need."""
    try:
        os.path.abspath(path).encode("utf-8")
    except UnicodeEncodeError:
        shown = str(path).encode(errors="backslashreplace").decode()
        raise StorageError(
            f"{shown} cannot be written: a name in its path is not UTF-8. Use another folder or, where only the locale"
            " is another one (LC_ALL=C), set PYTHONUTF8=1."
        ) from None


def check_writable(folder: str | os.PathLike[str]) -> None:
    """Raise StorageError if ``folder``, which may not exist yet, clearly cannot be written to."""
    check_encodable(folder)
    place = Path(folder).absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise StorageError(f"{folder} cannot be written: {place} is a file, not a folder.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise StorageError(f"{folder} cannot be written: {place} is read-only; choose another folder.")


def check_links(folder: Path, names: Collection[str] = ()) -> None:
    """Raise RunError if ``folder`` contains a symbolic link that points outside.

    Whoever unpacks or clones a folder gets its links, too. Pipes and devices are refused as well. What loggers make in
    folders of their own (:data:`LOGGERS`) is left to them.

    Args:
        names: files and folders in ``folder`` that are looked at; none: all.
    """
    if not os.path.isdir(folder):
        return
    root = Path(os.path.realpath(folder))
    entries = [entry for entry in os.scandir(folder) if not names or entry.name in names]
    while entries:
        entry = entries.pop()
        if entry.is_symlink():
            target = os.path.realpath(entry.path)
            if not Path(target).is_relative_to(root):
                raise RunError(
                    f"{entry.path} is a link that leads out of its folder, to {target}. Remove it, or put there what it"
                    " leads to: what is written into a folder has to lie in it."
                )
        elif entry.is_dir():
            entries += os.scandir(entry) if entry.name not in LOGGERS else []
        elif not entry.is_file():
            raise RunError(f"{entry.path} is neither a file nor a folder; remove it.")


@contextmanager
def claimed(folder: Path, wait: bool = False) -> Iterator[None]:
    """Lock ``folder`` within the block, so that no other process writes there.

    The system releases it when the process ends.

    RunError: another process does, and this one should not ``wait`` until it has ended; or see :func:`check_links`.
    """
    with ExitStack() as stack:
        with writing(folder):
            try:
                stack.enter_context(path_lock(folder, wait))
            except BlockingIOError:
                raise RunError(f"Another process is writing to {folder}; there can be one at a time.") from None
            check_links(folder)
        yield


def sweep(folder: Path) -> None:
    """Delete temporary files that ended processes left in ``folder`` and its subfolders."""
    for file in folder.rglob(f"{MARK}*"):
        with suppress(OSError), path_lock(file):
            file.unlink()


def to_json(content: Any) -> str:
    """Serialise ``content`` to JSON, with null for infinity and NaN."""
    return json.dumps(_finite(content), indent=2, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_yaml(config: Any) -> str:
    """Serialise a configuration to YAML; lists of plain values take one line."""
    return yaml.dump(dataclasses.asdict(config), Dumper=_Dumper, sort_keys=False, width=110)


class _Dumper(yaml.SafeDumper):
    """YAML dumper that writes each row of a body on one line."""


def _represent_list(dumper: _Dumper, values: list) -> yaml.Node:
    flat = not any(isinstance(value, list | dict) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(Code, lambda dumper, code: dumper.represent_str(str(code)))
