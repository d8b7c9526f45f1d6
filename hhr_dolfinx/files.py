"""Atomic files: one function that writes files, and one that reads arrays back.

Writing: the content goes to a temporary file, is synced to the disk, and is renamed to the target
in one step. The temporary file is locked (``flock``) as long as its process lives: one that can be
locked is a leftover. Unlike process numbers and ages, locks work across containers and machines
that share a folder.

Reading: arrays are an uncompressed ``.npz`` file with a header (JSON) that has a checksum of
everything. Nothing is allocated before its size is known to fit into the file, no pickle and no
Python literal is evaluated, and any fault raises :class:`FileContentError`.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import re
import secrets
import stat
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeAlias, cast

import numpy as np

from hhr_dolfinx.errors import FileContentError, FileError, HHRError

try:
    import resource
except ImportError:  # not Unix
    resource = None  # type: ignore[assignment]

MOST_FILE_BYTES = 16 * 2**30
"""Size beyond which a file is not read: a sparse file may claim any size without using the disk."""

MAPPED_BYTES = 2**20
"""Bytes from which on arrays may be mapped from disk: smaller ones are not worth it."""
_CHUNK = 2**20  # bytes read at once; the directories of a few dozen members take some kilobytes

_LEFTOVER = re.compile(r".+\.[0-9a-f]{16}\.part")

_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space or choose another folder"),
    **dict.fromkeys(
        (errno.EROFS, errno.EACCES, errno.EPERM), "choose a folder that you may write to"
    ),
    **dict.fromkeys(
        (errno.ENOTDIR, errno.EEXIST),
        "a file stands where a folder is needed, move it or choose another",
    ),
    errno.EISDIR: "a folder has this name, choose another name",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def make_folder(folder: str | Path) -> Path:
    """Make a folder and its missing parents; FileError if that is impossible."""
    folder = _named(folder)
    with _explained(folder, "made"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def replacing(path: str | Path, *, text: bool = False, tidy: bool = True) -> Iterator[IO[Any]]:
    """Open a file that becomes ``path`` at the end of the block unless it fails.

    Args:
        path: the file, or a link to it.
        text: True for text, in UTF-8 without conversion of line ends.
        tidy: remove temporary files of killed processes in the folder: once is enough for many
            files.

    Raises:
        FileError: if the file cannot be written, or is not a regular one.
    """
    path = _target(_named(path))
    folder = make_folder(path.parent)
    if tidy:
        clear_leftovers(folder)
    with _explained(path, "written"):
        temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}.part")
        try:  # starts before the file exists: an interrupt may come at any time
            with _opened(temporary, text) as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
                os.replace(temporary, path)  # before the lock ends with the file
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    _sync_folder(folder)


def clear_leftovers(folder: str | Path) -> None:
    """Remove temporary files of processes that have ended; files that are being written stay."""
    for path in Path(folder).glob("*.part"):
        if _LEFTOVER.fullmatch(path.name):
            # already removed, or owned by another user: no reason to fail
            with suppress(OSError), open(path, "r+b") as file:
                if _lock(file, wait=False):
                    path.unlink(missing_ok=True)


Json: TypeAlias = "Mapping[str, Json] | Sequence[Json] | str | float | None"
"""Data of JSON: objects, lists, strings, numbers, truth values and null."""

LONGEST_HEADER = 9_999_999
"""Largest number of characters of a header."""


def write_arrays(
    path: str | Path,
    header: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
    *,
    tidy: bool = True,
) -> None:
    """Write arrays of finite numbers or booleans with a header and a checksum over both.

    See :func:`replacing`.

    Args:
        path: the file.
        header: JSON data with ``format`` and ``version``, by which :func:`read_arrays` identifies
            the file.
        arrays: the arrays by name.
        tidy: see :func:`replacing`.

    Raises:
        FileContentError: for arrays of other numbers, and for a header that is too long.
    """
    contiguous = {
        name: array if array.flags.forc else array.copy() for name, array in arrays.items()
    }
    try:
        for name, array in contiguous.items():
            _check_numbers(name, array)
    except _Damage as error:
        raise FileContentError(f"{path} is not written: {error}") from None
    signed = {**header, "sha256": _checksum(header, contiguous)}
    text = json.dumps(signed, separators=(",", ":"))
    if len(text) > LONGEST_HEADER:
        reason = (
            f"{len(text)} characters beside the arrays are more than {LONGEST_HEADER}: keep many "
            "numbers in arrays"
        )
        raise FileContentError(f"{path} is not written: {reason}")
    with replacing(path, tidy=tidy) as file:
        members: dict[str, Any] = {"header": np.array(text.encode()), **contiguous}
        np.savez(file, **members)


def read_arrays(
    path: str | Path, kind: str, version: int, *, mapped: bool = False
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read header and arrays of a file from :func:`write_arrays`.

    Memory stays near the size of the file.

    Args:
        path: the file.
        kind: its ``format``.
        version: its ``version``.
        mapped: map arrays of a megabyte and more from disk, as long as half of the allowed
            descriptors are free; they may start at any byte. The file may be replaced meanwhile,
            but must not be modified in place.

    Raises:
        FileNotFoundError: if there is no such file, for the caller to handle.
        FileContentError: if the file cannot be read, is damaged, or has another ``format`` or
            ``version``.
    """
    path = Path(path)
    with _own_errors(path):
        os.stat(path)  # raises with the reason, which is_file would hide
        if not path.is_file():
            raise _Damage("it is no regular file")
        arrays = _members(path, MAPPED_BYTES if mapped else MOST_FILE_BYTES + 1)
        header = _header(arrays)
        named = header.get("format")
        if not isinstance(named, str) or not named.startswith(kind.split()[0]):
            raise _Damage(f"its header names no '{kind}'")
        if (named, header.get("version")) != (kind, version):
            content = f"'{named[:40]}' version {repr(header.get('version'))[:40]}"
            raise FileContentError(
                f"{path} holds {content}, this release reads '{kind}' version {version}"
            )
        for name, array in arrays.items():
            _check_numbers(name, array)
        stored = header.pop("sha256", None)
        if stored != _checksum(header, arrays):
            raise FileContentError(f"the checksum of {path} does not match its content")
    return header, arrays


def format_of(path: str | Path) -> str:
    """Format that the header of a file from :func:`write_arrays` names; empty for other files.

    Args:
        path: the file.
    """
    path = Path(path)
    try:
        with _own_errors(path):
            named = _header(_members(path, MAPPED_BYTES)).get("format") if path.is_file() else ""
    except HHRError:
        return ""
    return named if isinstance(named, str) else ""


def _header(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Header of a file, which is removed from its arrays."""
    text = arrays.pop("header", None)
    if text is None or text.dtype.kind not in "SU" or text.ndim:
        raise _Damage("it has no header")
    header = json.loads(text.item())
    return header if isinstance(header, dict) else {}


NUMBER_KINDS = {"<f8": "float", "<f4": "float", "<i8": "int", "<i4": "int", "|b1": "bool"}
"""Kinds of numbers of arrays in files, by their names in numpy."""
_UTF8 = 0x800
"""Flag of members of archives with names that are not ASCII."""
_DESCRIPTION = re.compile(
    rb"\{'descr': '(<f8|<f4|<i8|<i4|\|b1|[<|][SU][0-9]{1,7})', 'fortran_order': (True|False), "
    rb"'shape': \(([0-9, ]{0,80})\), \} *\n"
)


@contextmanager
def _explained(path: Path, what: str) -> Iterator[None]:
    """Convert errors of the system to a FileError with the name of the file and advice."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        remedy = _REMEDIES.get(error.errno or 0, "check the disk and the folder")
        raise FileError(f"{path} cannot be {what} ({error.strerror or error}): {remedy}") from error


def _named(path: str | Path) -> Path:
    if "\0" in str(path):
        raise FileError(
            f"{str(path)!r} has a zero byte, which no name may have: choose another name"
        )
    return Path(path)


def _target(path: Path) -> Path:
    """File to replace, with links resolved; never a device or a pipe, which root could destroy."""
    if not path.name:
        raise FileError(f"'{path}' names a folder: add the name of a file")
    with _explained(path, "written"):
        try:
            kind = os.stat(path).st_mode
        except (FileNotFoundError, NotADirectoryError):  # make_folder raises a better error
            kind = stat.S_IFREG
        if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
            raise FileError(
                f"{path} is a device or a pipe, and no file that could be replaced: choose "
                "another name"
            )
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _opened(temporary: Path, text: bool) -> IO[Any]:
    while True:
        file = open(temporary, "x", encoding="utf-8", newline="") if text else open(temporary, "xb")
        _lock(file, wait=True)
        if os.fstat(file.fileno()).st_nlink:
            return file
        file.close()  # another process removed it as a leftover before it was locked


def _lock(file: IO[str] | IO[bytes], wait: bool) -> bool:
    """Lock a file until it is closed; False if that is impossible."""
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except (ImportError, OSError):  # locked by a running process, or a system without locks
        return False
    return True


def _sync_folder(folder: Path) -> None:
    """Sync the new name to the disk; errors of systems that cannot sync folders are ignored."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class _Damage(Exception):
    """Fault of a file, whose name :func:`_own_errors` adds."""


@contextmanager
def _own_errors(path: Path) -> Iterator[None]:
    """Convert any error of reading to :class:`FileContentError`."""
    try:
        yield
    except (HHRError, FileNotFoundError):
        raise
    except OSError as error:
        raise FileContentError(f"{path} cannot be read ({error.strerror or error})") from error
    # On damaged bytes zipfile, json and numpy raise BadZipFile, RuntimeError, NotImplementedError,
    # EOFError, ValueError, OverflowError, struct.error, RecursionError, MemoryError ...: no list of
    # them is complete.
    except Exception as error:
        reason = str(error) if isinstance(error, _Damage) else f"{type(error).__name__}: {error}"
        raise FileContentError(f"{path} is damaged or another kind of file ({reason})") from error


class _Pieces(io.FileIO):
    """A file that is read in small pieces, since zipfile reads the whole directory of an archive,
    of any length.
    """

    def read(self, size: int | None = -1) -> bytes:
        """Read ``size`` bytes, or all.

        Raises:
            _Damage: for a piece that is too long.
        """
        if size is None or size < 0:
            size = os.fstat(self.fileno()).st_size - self.tell()
        if size > _CHUNK:
            raise _Damage("its directory is too long")
        return super().read(size)


def _descriptors_left() -> bool:
    """True if half of the descriptors allowed for this process are free.

    False if the system does not report it.
    """
    try:
        return (
            resource is not None
            and len(os.listdir("/dev/fd")) < resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 2
        )
    except OSError:
        return False


def _members(path: Path, mapped: int) -> dict[str, np.ndarray]:
    """Arrays of an uncompressed archive by name.

    Those of at least ``mapped`` bytes are mapped from disk.
    """
    arrays = {}
    mapped_file = None
    with _Pieces(path) as file, zipfile.ZipFile(file) as archive:
        if not _descriptors_left():
            mapped = MOST_FILE_BYTES + 1
        size = os.fstat(file.fileno()).st_size
        infos = archive.infolist()
        if size > MOST_FILE_BYTES:
            raise _Damage(f"its {size} bytes are more than {MOST_FILE_BYTES}")
        for info in infos:
            name = info.filename.removesuffix(".npy")
            if (
                info.compress_type != zipfile.ZIP_STORED
                or info.flag_bits & ~_UTF8
                or info.compress_size != info.file_size
            ):
                raise _Damage(f"{name} is compressed or encrypted")
            # the sum of all members, as those of a hostile archive may share their bytes
            size -= info.file_size
            if size < 0:
                raise _Damage("its directory promises more bytes than it has")
            if name in arrays:
                raise _Damage(f"{name} is there twice")
            with archive.open(info) as stream:
                member = None
                if info.file_size >= mapped:
                    # copy on write: changes of an answer must not change the file
                    mapped_file = (
                        np.asarray(np.memmap(path, np.uint8, "c"))
                        if mapped_file is None
                        else mapped_file
                    )
                    # the local header may be longer than the one in the directory
                    header = mapped_file[info.header_offset : info.header_offset + 30]
                    lengths = (
                        int.from_bytes(header[k : k + 2].tobytes(), "little") for k in (26, 28)
                    )
                    start = info.header_offset + 30 + sum(lengths)
                    member = mapped_file[start : start + info.file_size]
                arrays[name] = _array(cast(io.BufferedIOBase, stream), info, member)
    return arrays


def _array(
    stream: io.BufferedIOBase, info: zipfile.ZipInfo, member: np.ndarray | None
) -> np.ndarray:
    """Read one array; ``member`` has the bytes of a mapped one.

    The description is compared with the only form that numpy writes, never evaluated, and must
    match the size.
    """
    start = stream.read(10)
    description = stream.read(int.from_bytes(start[8:], "little"))
    match = _DESCRIPTION.fullmatch(description)
    if start[:8] != b"\x93NUMPY\x01\x00" or match is None:
        raise _Damage(f"{info.filename} is no plain array of numbers")
    dtype = np.dtype(match[1].decode())
    shape = tuple(int(size) for size in match[3].split(b",") if size.strip())
    count = math.prod(shape)
    if count * dtype.itemsize != info.file_size - len(start) - len(description):
        raise _Damage(f"{info.file_size} bytes of {info.filename} do not hold shape {shape}")
    flat = (
        np.empty(count, dtype)
        if member is None
        else member[len(start) + len(description) :].view(dtype)
    )
    if member is None:
        _fill(flat, stream, info)
    return flat.reshape(shape[::-1]).T if match[2] == b"True" else flat.reshape(shape)


def _fill(flat: np.ndarray, stream: io.BufferedIOBase, info: zipfile.ZipInfo) -> None:
    raw = memoryview(flat.view(np.uint8)) if flat.nbytes else memoryview(b"")
    filled = 0
    while filled < len(raw):
        read = stream.readinto(raw[filled : filled + _CHUNK])
        if not read:
            raise _Damage(f"{info.filename} ends early")
        filled += read
    stream.read(1)  # at the end zipfile compares its checksum


def _check_numbers(name: str, array: np.ndarray) -> None:
    """Raise for unsupported kinds of numbers, non-finite numbers, and booleans that are neither 0
    nor 1.
    """
    if array.dtype.str not in NUMBER_KINDS:
        raise _Damage(f"{name} has type {array.dtype}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise _Damage(f"{name} is not finite")
    if array.dtype.kind == "b" and array.size and array.view(np.uint8).max() > 1:
        raise _Damage(f"{name} has values that are neither true nor false")


def _checksum(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """Checksum of the header and every array with name, type, shape and order, on which last digits
    of sums depend.
    """
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        array = arrays[name]
        order = "C" if array.flags.c_contiguous else "F"
        digest.update(f"\n{name} {array.dtype.str} {array.shape} {order}\n".encode())
        digest.update(array.ravel(order="K").view(np.uint8))
    return digest.hexdigest()
