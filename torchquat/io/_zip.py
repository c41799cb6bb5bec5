"""Arrays in an npz archive: read without a pickle, written back byte for byte."""

import io
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from torchquat.io.motion import FormatError

__all__ = ["OPAQUE", "Archive", "pack", "said"]

MAX_BYTES = 4 * 2**30
"""Largest unpacked size that is read; raise it for larger archives."""

# AMASS SMPL-X files hold a dictionary here. It is carried along as bytes, and never unpickled.
OPAQUE = frozenset({"markers_latent_vids"})

# an offset before the start of the file is an OSError, a spoilt name a UnicodeDecodeError
_UNSOUND = (
    zipfile.BadZipFile,
    NotImplementedError,
    EOFError,
    zlib.error,
    OSError,
    UnicodeDecodeError,
)

# headers are Python literals
_NO_HEADER = (ValueError, KeyError, TypeError, SyntaxError, tokenize.TokenError, RecursionError)

Anything = NDArray[np.generic]


class Archive:
    """All entries of an npz file, unpacked but not interpreted.

    Args:
        path: File to read.

    Raises:
        FormatError: If the file is no sound zip archive of plain arrays.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.entries: list[tuple[zipfile.ZipInfo, bytes]] = []
        with path.open("rb") as stream:
            try:
                with zipfile.ZipFile(stream) as file:
                    self._check_names(file.infolist())
                    self.entries = [(info, file.read(info)) for info in file.infolist()]
            except _UNSOUND as error:
                raise FormatError(f"{path}: expected an npz archive, got {error}") from None
        for info, content in self.entries:
            self._check_header(info, content)

    def _check_names(self, infos: list[zipfile.ZipInfo]) -> None:
        names = [info.filename for info in infos]
        for info in infos:
            if info.flag_bits & 0x1:
                raise FormatError(f"{self.path}: expected plain entries, got an encrypted one")
            parts = PurePosixPath(info.filename).parts
            if not info.filename.endswith(".npy") or ".." in parts or "/" in parts[:1]:
                raise FormatError(f"{self.path}: expected NAME.npy, got {info.filename!r}")
            if names.count(info.filename) > 1:
                raise FormatError(f"{self.path}: expected {info.filename!r} once, got it twice")
        size = sum(info.file_size for info in infos)
        if size > MAX_BYTES:
            raise FormatError(f"{self.path}: expected at most {MAX_BYTES} bytes, got {size}")

    def _check_header(self, info: zipfile.ZipInfo, content: bytes) -> None:
        """Refuse pickles, and sizes that the entry does not have, before anything is allocated."""
        stream = io.BytesIO(content)
        try:
            version = np.lib.format.read_magic(stream)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # headers of Python 2, which are read
                shape, _, dtype = read(stream)
        except _NO_HEADER as error:
            reason = " ".join(str(error).split())
            raise FormatError(f"{self.path}: {info.filename}: no array: {reason}") from None
        key = info.filename.removesuffix(".npy")
        if dtype.hasobject:
            if key in OPAQUE:
                return
            raise FormatError(
                f"{self.path}: {key}: expected a plain array, got Python objects: "
                "reading them would run a pickle"
            )
        wanted = int(np.prod(shape, dtype=object)) * dtype.itemsize
        if wanted != len(content) - stream.tell():
            raise FormatError(
                f"{self.path}: {key}: expected {wanted} bytes for shape {shape}, "
                f"got {len(content) - stream.tell()}"
            )

    @property
    def keys(self) -> list[str]:
        """Names of the arrays, in the order of the file."""
        return [info.filename.removesuffix(".npy") for info, _ in self.entries]

    def array(self, key: str) -> Anything:
        """One array."""
        content = dict(zip(self.keys, (content for _, content in self.entries), strict=True))[key]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # said of headers of Python 2
            return np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)

    def rewritten(self, replaced: Mapping[str, Anything]) -> bytes:
        """The archive with some arrays replaced, in the same order with the same dates."""
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as file:
            for (info, content), key in zip(self.entries, self.keys, strict=True):
                entry = zipfile.ZipInfo(info.filename, info.date_time)
                entry.external_attr = info.external_attr
                entry.compress_type = info.compress_type
                file.writestr(entry, _npy(replaced[key]) if key in replaced else content)
        return buffer.getvalue()


def pack(arrays: Mapping[str, Anything]) -> bytes:
    """A new compressed archive; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for key, array in arrays.items():
            entry = zipfile.ZipInfo(f"{key}.npy", (1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            file.writestr(entry, _npy(array))
    return buffer.getvalue()


def said(array: Anything) -> str:
    """An array in an error: one number, or its kind and shape."""
    return str(array) if array.size == 1 else f"{array.dtype} {array.shape}"


def _npy(array: Anything) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()
