"""Files made to exhaust whoever reads them."""

import io as memory
import pickle
import zipfile
from collections.abc import Callable

import make_estimates as made
import numpy as np
import torch
from bvh_files import ROTATIONS, bvh_text, joint
from estimate_files import Bomb

DEPTH = 10_000


def _npz(entries: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = memory.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as archive:
        for name, content in entries.items():
            archive.writestr(f"{name}.npy", content)
    return out.getvalue()


def _array(value: np.ndarray) -> bytes:
    out = memory.BytesIO()
    np.lib.format.write_array(out, value, allow_pickle=True)
    return out.getvalue()


def _claim(shape: tuple[int, ...], content: bytes = bytes(64)) -> bytes:
    out = memory.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, header)
    return out.getvalue() + content


def _with(poses: bytes) -> bytes:
    rest = {name: _array(value) for name, value in made.amass(4).items() if name != "poses"}
    return _npz({"poses": poses, **rest})


def _bomb() -> bytes:
    """512 MiB of zeros in half a mebibyte."""
    return _npz({"poses": _claim((2**20, 64), bytes(2**29))})


def _deep_bvh() -> bytes:
    lines = ["HIERARCHY"]
    for depth in range(DEPTH):
        lines += [f"{'JOINT' if depth else 'ROOT'} j{depth}", "{", "OFFSET 0 1 0", "CHANNELS 0"]
    return "\n".join([*lines, "MOTION", "Frames: 0", "Frame Time: 0.01", ""]).encode()


def _laughs() -> bytes:
    """Nine lists of nine of the list before: a billion words to whoever writes them out."""
    lines = ["a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]"]
    lines += [f"a{n}: &a{n} [{', '.join(9 * [f'*a{n - 1}'])}]" for n in range(1, 10)]
    return "\n".join([*lines, "filter: {class_path: *a9, init_args: {sigma_t: *a9}}", ""]).encode()


def _saved(tree: object) -> bytes:
    out = memory.BytesIO()
    torch.save(tree, out)
    return out.getvalue()


def _nested(depth: int) -> bytes:
    """A pickle of lists in lists, written by hand: its own writer would not get so deep."""
    return b"\x80\x02" + b"]" * depth + b"a" * (depth - 1) + b"."


def _one_row(frames: str, *row: str) -> bytes:
    text = bvh_text(joint("hip", ROTATIONS, end_site="0 1 0"), rows=[[1, 2, 3]])
    head = text[: text.index("Frames:")]
    return f"{head}Frames: {frames}\nFrame Time: 0.01\n{' '.join(row)}\n".encode()


HOSTILE: dict[str, tuple[str, Callable[[], bytes]]] = {
    "zip bomb": (".npz", _bomb),
    "10^12 floats": (".npz", lambda: _with(_claim((10**12,)))),
    "10^12 rows of nothing": (".npz", lambda: _with(_claim((10**12, 0), b""))),
    "a shape beyond 64 bits": (".npz", lambda: _with(_claim((10**12, 10**12)))),
    "object array": (".npz", lambda: _with(_array(np.array([Bomb()], dtype=object)))),
    "pickle called npz": (".npz", lambda: pickle.dumps(Bomb())),
    "pickle called pt": (".pt", lambda: pickle.dumps(Bomb())),
    "pickle called bvh": (".bvh", lambda: pickle.dumps(Bomb())),
    "pickle called yaml": (".yaml", lambda: pickle.dumps(Bomb())),
    "code in a pt": (".pt", lambda: _saved({"smpl_params_global": Bomb()})),
    "lists in lists, pt": (".pt", lambda: _nested(DEPTH)),
    "lists in lists, pkl": (".pkl", lambda: _nested(DEPTH)),
    "lists in lists, YAML": (".yaml", lambda: b"filter: " + b"[" * DEPTH + b"]" * DEPTH),
    "a billion laughs": (".yaml", _laughs),
    "depth 10,000, never closed": (".bvh", _deep_bvh),
    "10^12 frames": (".bvh", lambda: _one_row("1000000000000", "1", "2", "3")),
    "10^12 frames of nothing": (
        ".bvh",
        lambda: (
            b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\n"
            b"MOTION\nFrames: 1000000000000\nFrame Time: 0.01\n"
        ),
    ),
    "a number of 10^6 digits": (".bvh", lambda: _one_row("1", "9" * 10**6, "2", "3")),
    "10^6 digits of frames": (".bvh", lambda: _one_row("9" * 10**6, "1", "2", "3")),
    "10^6 channels": (
        ".bvh",
        lambda: b"HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1000000 " + b"Xrotation " * 10**6,
    ),
    "a line of 10^7 letters": (".bvh", lambda: b"HIERARCHY " + b"x" * 10**7),
    "10^6 empty lines": (".bvh", lambda: b"HIERARCHY" + b"\n" * 10**6),
    "20,000 roots of one name": (
        ".bvh",
        lambda: b"HIERARCHY\n" + b"ROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\n" * 20_000,
    ),
}
"""What they are: the ending of their names, and what makes them."""
