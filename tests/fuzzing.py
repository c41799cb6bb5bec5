"""Broken files from good ones: bytes, words and trees are changed at random."""

import io as memory
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import make_estimates as made
import numpy as np
import torch
from bvh_files import IRREGULAR, POSITIONS, ROTATIONS, bvh_text, joint

Mutate = Callable[[random.Random], bytes]

ODD_WORDS = (
    "nan inf -inf 1e400 -1e-400 1_000 0x10 1,5 - + . e5 1e 1e+ --1 0.0-7.5 99999999999999999999 "
    "\u0661\u0662 {{ }} { } ROOT JOINT End Site MOTION Frames: Frame Time: CHANNELS OFFSET "
    "HIERARCHY Xrotation Zposition Wrotation -1 0 3 7 1000000000000 \x0b \x85 \u2028 # \x00"
).split(" ")
ODD_BYTES = (
    b"\x00",
    b"\xff",
    b"\r",
    b"\n",
    b"\t",
    b" ",
    b"{",
    b"}",
    b"\x1a",
    b"\xef\xbb\xbf",
    b"9" * 400,
)
ODD_SHAPES = ("(10**12,)", "(1000000000000, 3)", "(-1,)", "()", "(0, 3)", "(2, 3, 4, 5)", "(1,")


def mangled(content: bytes, rng: random.Random) -> bytes:
    """One to four changes of bytes."""
    for _ in range(rng.randint(1, 4)):
        at, to = sorted(rng.randrange(len(content) + 1) for _ in range(2))
        to = min(to, at + rng.choice((1, 1, 8, 200)))
        middle = content[at:to]
        change = rng.randrange(6)
        if change == 0:
            middle = bytes([rng.randrange(256)])
        elif change == 1:
            middle = b""
        elif change == 2:
            middle *= rng.choice((2, 2, 9))
        elif change == 3:
            middle = rng.choice(ODD_BYTES) + middle
        elif change == 4 and middle:
            middle = bytes([middle[0] ^ (1 << rng.randrange(8))]) + middle[1:]
        else:
            to = len(content) if rng.random() < 0.3 else to
            middle = b""
        content = content[:at] + middle + content[to:]
    return content


def reworded(content: bytes, rng: random.Random) -> bytes:
    """One to three changes of words or lines, grammar in mind."""
    lines = [line.split(" ") for line in content.decode("latin-1").split("\n")]
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(lines))
        change = rng.randrange(6)
        if change == 0 and len(lines) > 1:
            del lines[at]
        elif change == 1:
            lines.insert(at, list(rng.choice(lines)))
        elif change == 2:
            lines[at].insert(rng.randrange(len(lines[at]) + 1), rng.choice(ODD_WORDS))
        elif change == 3 and len(lines[at]) > 1:
            del lines[at][rng.randrange(len(lines[at]))]
        elif change == 4:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        else:
            lines[at][rng.randrange(len(lines[at]))] = rng.choice(ODD_WORDS)
    return "\n".join(" ".join(line) for line in lines).encode("utf-8", "surrogatepass")


def odd_leaf(value: Any, rng: random.Random) -> Any:
    """Something else than what belongs there."""
    array = np.asarray(value) if not isinstance(value, torch.Tensor) else value.numpy()
    choices: list[Any] = [
        None,
        "text",
        -1,
        float("nan"),
        [],
        {},
        np.zeros(0),
        np.array(["a", "b"]),
        np.zeros((3, 5), complex),
    ]
    if array.dtype.kind in "fiu" and array.size:
        broken = array.astype(np.float64)
        broken.flat[rng.randrange(array.size)] = rng.choice((np.nan, np.inf, 1e300, 0.0))
        choices += [
            broken,
            array[..., :-1] if array.ndim else array,
            array.reshape(-1),
            array[:0] if array.ndim else array,
            array.astype(">f8"),
            array.astype(np.float16),
            array.astype(int, casting="unsafe"),
            np.concatenate([array, array]) if array.ndim else array,
            array[::-1] if array.ndim else array,
        ]
    with np.errstate(all="ignore"):
        found = rng.choice(choices)
    wanted = isinstance(value, torch.Tensor) and isinstance(found, np.ndarray)
    if wanted and found.dtype.kind in "fiuc" and found.dtype.isnative:
        return torch.from_numpy(np.array(found))
    return found


def odd_tree(tree: Any, rng: random.Random) -> Any:
    """The same tree with a leaf changed, lost or under another name."""
    if isinstance(tree, dict) and tree:
        key, copy = rng.choice(list(tree)), dict(tree)
        change = rng.randrange(8)
        if change == 0:
            del copy[key]
        elif change == 1:
            copy[rng.choice(("other", 7, "poses"))] = copy.pop(key)
        else:
            copy[key] = odd_tree(tree[key], rng)
        return copy
    if isinstance(tree, list) and tree and rng.random() < 0.8:
        at = rng.randrange(len(tree))
        return [*tree[:at], odd_tree(tree[at], rng), *tree[at + 1 :]]
    return odd_leaf(tree, rng)


def npz(tree: dict[str, Any], rng: random.Random) -> bytes:
    """An archive whose arrays, names or headers are odd."""
    out = memory.BytesIO()
    with zipfile.ZipFile(out, "w", rng.choice((0, 8))) as archive:
        for key, value in tree.items():
            entry = memory.BytesIO()
            array = np.asarray(value)
            np.lib.format.write_array(entry, array, allow_pickle=True)
            content = entry.getvalue()
            if rng.random() < 0.02:
                shape, odd = str(array.shape).encode(), rng.choice(ODD_SHAPES).encode()
                content = content.replace(shape, odd.ljust(len(shape))[: max(len(shape), len(odd))])
            elif rng.random() < 0.02:
                content = mangled(content, rng)
            archive.writestr(f"{key}.npy" if rng.random() < 0.99 else f"../{key}", content)
    return out.getvalue()


def _bvh() -> list[bytes]:
    arm = joint("arm", ROTATIONS, joint("hand", "Yrotation", end_site="0 1 0"))
    root = joint("hip", f"{POSITIONS} {ROTATIONS}", arm, joint("leg", ROTATIONS, end_site="0 1 0"))
    rows = np.random.default_rng(0).normal(0, 40, (4, 13)).tolist()
    return [bvh_text(root, rows=rows).encode(), IRREGULAR]


def _saved(tree: Any) -> bytes:
    out = memory.BytesIO()
    torch.save(tree, out)
    return out.getvalue()


def _dumped(tree: Any) -> bytes:
    import joblib

    out = memory.BytesIO()
    joblib.dump(tree, out)
    return out.getvalue()


def generators(root: Path) -> dict[str, tuple[str, Mutate]]:
    """Kinds of broken files: the ending of their names, and what makes one."""
    bvh, configs = _bvh(), [path.read_bytes() for path in sorted((root / "configs").glob("*.yaml"))]
    trees = {"gvhmr": made.gvhmr(4), "wham": made.wham(), "phalp": made.phalp(8)}
    amass, smpl = made.amass(4), made.smpl(4)
    whole = {"pt": _saved(trees["gvhmr"]), "npz": npz(amass, random.Random(0))}
    return {
        "bvh, bytes": (".bvh", lambda rng: mangled(rng.choice(bvh), rng)),
        "bvh, words": (".bvh", lambda rng: reworded(rng.choice(bvh), rng)),
        "npz, bytes": (".npz", lambda rng: mangled(whole["npz"], rng)),
        "npz, AMASS": (".npz", lambda rng: npz(odd_tree(amass, rng), rng)),
        "npz, SMPL": (".smpl.npz", lambda rng: npz(odd_tree(smpl, rng), rng)),
        "pt, bytes": (".pt", lambda rng: mangled(whole["pt"], rng)),
        "pt, tree": (".pt", lambda rng: _saved(odd_tree(trees["gvhmr"], rng))),
        "pkl, WHAM": (".pkl", lambda rng: _dumped(odd_tree(trees["wham"], rng))),
        "pkl, PHALP": (".pkl", lambda rng: _dumped(odd_tree(trees["phalp"], rng))),
        "config": (".yaml", lambda rng: rng.choice((mangled, reworded))(rng.choice(configs), rng)),
    }
