"""The shape of the code: imports run downward, nothing else is needed, files stay small."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "torchquat"
SOURCES = sorted(PACKAGE.rglob("*.py"))
EVERYTHING = [*SOURCES, *sorted((ROOT / "examples").glob("*.py"))]

# A module imports only from ranks below its own, or from its own folder.
RANKS = {
    "torchquat._eager": 0,
    "torchquat._checks": 1,
    "torchquat._running": 0,
    "torchquat._pull_back": 1,
    "torchquat._series": 1,
    "torchquat._planes": 2,
    "torchquat._operations": 3,
    "torchquat._blocks": 4,
    "torchquat.so3": 4,
    "torchquat.missing": 5,
    "torchquat.timeline": 6,
    "torchquat.noise": 6,
    "torchquat.skeleton": 6,
    "torchquat.ragged": 6,
    "torchquat.representation": 6,
    "torchquat.metrics": 7,
    "torchquat.filters": 7,
    "torchquat._online": 8,
    "torchquat.io": 8,
    "torchquat.chunks": 9,
    "torchquat.streaming": 9,
    "torchquat": 10,
}

# What a module may import besides when it is asked for: the extra "estimators".
OPTIONAL = {"torchquat.io._trees": {"joblib"}}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def rank(name: str) -> int:
    while name not in RANKS:
        name = name.rpartition(".")[0]
    return RANKS[name]


def imports(path: Path) -> set[str]:
    """Full names of all that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module
            inside = node.module == "torchquat"
            found |= {f"{node.module}.{a.name}" for a in node.names} if inside else {node.module}
    return found


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_imports_run_downward(path):
    own = module_name(path)
    for name in imports(path):
        if name.split(".")[0] != "torchquat":
            continue
        same_folder = own.split(".")[:2] == name.split(".")[:2] and own != "torchquat"
        assert name != "torchquat", f"{own} imports the package itself"
        assert same_folder or rank(name) < rank(own), f"{own} imports {name} from above"


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_needs_torch_numpy_and_roma_only(path):
    for name in imports(path):
        top = name.split(".")[0]
        optional = OPTIONAL.get(module_name(path), set())
        needed = {"torchquat", "torch", "numpy", "roma"} | optional
        assert top in needed | sys.stdlib_module_names, name


@pytest.mark.parametrize("path", EVERYTHING, ids=lambda path: path.stem)
def test_E11_nothing_runs_a_pickle_or_unsafe_yaml(path):
    text = path.read_text(encoding="utf-8")
    for unsafe in ("allow_pickle=True", "yaml.load(", "weights_only=False", "import pickle"):
        assert unsafe not in text
    assert "torch.load(" not in text or "weights_only=True" in text


@pytest.mark.parametrize("path", EVERYTHING, ids=lambda path: path.stem)
def test_files_stay_small(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 300


def test_every_module_has_a_rank():
    assert all(rank(module_name(path)) >= 0 for path in SOURCES)
    assert (PACKAGE / "py.typed").exists()


def test_importing_the_package_does_not_load_a_compiler():
    """It would take as long to start as PyTorch itself; roma loads it."""
    code = (
        "import sys, torchquat; print(*(m for m in ('roma', 'torch._dynamo') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.PIPE)
    assert done.stdout.split() == []
