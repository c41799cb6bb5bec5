"""Run the tests with the oldest and the newest versions that ``pyproject.toml`` admits.

python tests/try_versions.py FOLDER [--only oldest|newest] [pytest arguments]

Makes an environment of each in FOLDER, with the Python that runs this, and prints the versions and
the closing line of pytest. Optional tools are left out: what needs them is skipped.
"""

import argparse
import ast
import re
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEEDED = ("torch", "numpy", "roma")
TOOLS = (
    "pytest",
    "pytest-xdist",
    "hypothesis",
    "scipy",
    "pywavelets",
    "pybvh",
    "upc-pymotion",
    "joblib",
    "jsonargparse[signatures]",
    "pyyaml",
    "tqdm",
    "matplotlib",
)


def oldest() -> list[str]:
    """Requirements at their lower bounds."""
    # tomllib is newer than the oldest Python
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^dependencies = (\[.*\])$", project, re.M)
    assert listed is not None, project
    found = dict(each.split(">=") for each in ast.literal_eval(listed[1]))
    assert set(found) == set(NEEDED), found
    return [f"{name}=={bound}.*" for name, bound in found.items()]


def environment(folder: Path, requirements: list[str]) -> Path:
    """Python of a new environment with these packages and the project.

    Raises:
        subprocess.CalledProcessError: If they cannot be installed together.
    """
    venv.create(folder, with_pip=True, clear=True)
    python = folder / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "-q"]
    subprocess.run([*install, *requirements, *TOOLS], check=True)
    subprocess.run([*install, "--no-deps", "-e", str(ROOT)], check=True)
    return python


def tried(python: Path, arguments: list[str]) -> str:
    """Versions, and how the tests ended."""
    code = "import sys; from importlib.metadata import version as v; print(sys.version.split()[0], "
    code += ", ".join(f"v({name!r})" for name in NEEDED) + ")"
    said = subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True)
    versions = dict(zip(("Python", *NEEDED), said.stdout.split(), strict=True))
    tests = subprocess.run(
        [str(python), "-m", "pytest", "-q", "-n", "auto", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    lines = [line for line in tests.stdout.splitlines() if re.match(r"FAILED|ERROR", line)]
    closing = tests.stdout.strip().splitlines()[-1]
    head = ", ".join(f"{name} {number}" for name, number in versions.items())
    return "\n".join([f"{head}: {closing}", *(f"  {line}" for line in lines)])


def main() -> int:
    """Try both."""
    parser = argparse.ArgumentParser(description="Oldest and newest versions.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=("oldest", "newest"))
    arguments, rest = parser.parse_known_args()
    wanted = {"oldest": oldest(), "newest": list(NEEDED)}
    for name, requirements in wanted.items():
        if arguments.only in (None, name):
            python = environment(arguments.folder / name, requirements)
            print(f"{name}: {tried(python, rest)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
