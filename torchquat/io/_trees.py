"""Files that hold nested containers of arrays: read, and written with some leaves replaced."""

import copy
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from pickle import dumps
from pickletools import genops
from types import ModuleType
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from torchquat.io._zip import OPAQUE, Archive
from torchquat.io.motion import FormatError

__all__ = [
    "Array",
    "JoblibFile",
    "Leaves",
    "NpzFile",
    "TorchFile",
    "TreeFile",
    "array_of",
    "keys_of",
]

Array = NDArray[np.float64]
Key = tuple[Any, ...]
Leaves = Mapping[Key, Array]

# what a compressed file begins with, by joblib's names
_COMPRESSIONS = {
    b"\x78": "zlib",
    b"\x1f\x8b": "gzip",
    b"BZ": "bz2",
    b"\xfd7zXZ": "xz",
    b"\x5d\x00": "lzma",
    b"\x04\x22\x4d\x18": "lz4",
}
_LEVEL = 3  # as PHALP compresses


class TreeFile(Protocol):
    """A file that can be looked into, and written again with other numbers in some places."""

    @property
    def tree(self) -> Any:
        """What the file holds."""
        ...

    def rewritten(self, leaves: Leaves) -> bytes:
        """The file with the numbers at some paths replaced, in their shape, dtype and kind."""
        ...


@dataclass(frozen=True, eq=False)
class TorchFile:
    """What ``torch.save`` wrote, of tensors and plain containers only: no pickle is run."""

    tree: Any

    @classmethod
    def read(cls, path: Path) -> "TorchFile":
        """Load onto the CPU.

        Raises:
            FormatError: If the file is unsound, or would have to be unpickled.
        """
        with path.open("rb") as file:
            try:
                return cls(torch.load(file, map_location="cpu", weights_only=True))
            except Exception as error:  # spoilt files raise many kinds
                reason = str(error).partition("\n")[0] or type(error).__name__
                raise FormatError(
                    f"{path}: expected a file of torch.save that holds tensors and plain "
                    f"containers only (anything else would run a pickle), got {reason}"
                ) from None

    def rewritten(self, leaves: Leaves) -> bytes:
        """See :class:`TreeFile`."""
        buffer = io.BytesIO()
        torch.save(_replaced(self.tree, leaves), buffer)
        return buffer.getvalue()


@dataclass(frozen=True, eq=False)
class JoblibFile:
    """What ``joblib.dump`` wrote: a pickle, which runs whatever its author put into it.

    Attributes:
        tree: What it holds.
        compression: By joblib's name.
        protocol: Of a plain pickle, which is written as one; ``None``: joblib put arrays into it
            that no other program reads.
    """

    tree: Any
    compression: str | None
    protocol: int | None

    @classmethod
    def read(cls, path: Path, *, trust_pickle: bool) -> "JoblibFile":
        """Unpickle a file that the caller trusts.

        Raises:
            FormatError: If it is not trusted, or no joblib pickle.
            ImportError: If joblib is not installed.
        """
        with path.open("rb") as file:
            start = file.read(8)
        if trust_pickle is not True:
            raise FormatError(
                f"{path}: expected trust_pickle=True, got {trust_pickle!r}: reading a pickle runs "
                "whatever its author put into it; trust files that you made yourself"
            )
        try:
            tree = _joblib(path).load(path)
        except (ImportError, OSError):
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}".partition("\n")[0]
            raise FormatError(f"{path}: expected a joblib pickle, got {reason}") from None
        names = (name for magic, name in _COMPRESSIONS.items() if start.startswith(magic))
        compression = next(names, None)
        return cls(tree, compression, None if compression else _plain_protocol(path))

    def rewritten(self, leaves: Leaves) -> bytes:
        """See :class:`TreeFile`; compressed as it was, and a plain pickle stays one."""
        tree = _replaced(self.tree, leaves)
        if self.protocol is not None:
            return dumps(tree, self.protocol)
        buffer = io.BytesIO()
        compress = (self.compression, _LEVEL) if self.compression else 0
        _joblib().dump(tree, buffer, compress=compress)
        return buffer.getvalue()


@dataclass(frozen=True, eq=False)
class NpzFile:
    """An npz archive; its tree is a mapping of its arrays."""

    archive: Archive

    @property
    def tree(self) -> Mapping[str, Any]:
        """All arrays by name, but those that would have to be unpickled."""
        keys = [key for key in self.archive.keys if key not in OPAQUE]
        return {key: self.archive.array(key) for key in keys}

    def rewritten(self, leaves: Leaves) -> bytes:
        """See :class:`TreeFile`."""
        tree = self.tree
        return self.archive.rewritten({key: _like(leaves[key,], tree[key]) for (key,) in leaves})


def array_of(value: Any) -> Array | None:
    """The numbers of an array or tensor of floating-point numbers; ``None`` for anything else."""
    if isinstance(value, torch.Tensor) and value.is_floating_point():
        return value.detach().to("cpu", torch.float64).numpy()
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value.astype(np.float64)
    return None


def keys_of(tree: Any) -> str:
    """What there is instead of a key that is wanted, for an error."""
    if isinstance(tree, Mapping):
        return f"the keys {list(tree)[:20]}"
    return f"a {type(tree).__name__}"


def _replaced(tree: Any, leaves: Leaves) -> Any:
    """A tree with some leaves replaced; containers on the way are copied, all else is shared.

    One container may stand in several places of a tree. The copies are apart, so that a leaf is
    replaced in its own place only.
    """
    if () in leaves:
        return _like(leaves[()], tree)
    below: dict[Any, dict[Key, Array]] = {}
    for (first, *rest), leaf in leaves.items():
        below.setdefault(first, {})[tuple(rest)] = leaf
    branch = list(tree) if isinstance(tree, tuple) else copy.copy(tree)
    for key, own in below.items():
        branch[key] = _replaced(tree[key], own)
    if not isinstance(tree, tuple):
        return branch
    # a named tuple takes its fields one by one
    return type(tree)(*branch) if hasattr(tree, "_fields") else tuple(branch)


def _like(numbers: Array, value: Any) -> Any:
    """Numbers in the shape, dtype and kind of an array or tensor."""
    if isinstance(value, torch.Tensor):
        return torch.from_numpy(numbers.reshape(value.shape)).to(value.dtype)
    return numbers.reshape(value.shape).astype(value.dtype)


def _plain_protocol(path: Path) -> int | None:
    """Protocol of a pickle without the arrays of joblib; it is looked through, not run."""
    protocol = 0
    with path.open("rb") as file:
        try:
            for opcode, argument, _ in genops(file):
                if opcode.name == "PROTO":
                    protocol = argument
                if isinstance(argument, str) and argument.startswith("joblib."):
                    return None
        except ValueError:  # joblib made something of it all the same
            return None
    return protocol


def _joblib(path: Path | None = None) -> ModuleType:
    try:
        import joblib  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ImportError(
            f"{path or 'The file'}: reading it needs joblib: pip install 'torchquat[estimators]'"
        ) from None
    return joblib
