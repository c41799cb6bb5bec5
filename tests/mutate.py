"""Break the package on purpose, a little at a time: do its tests see it?

python tests/mutate.py FOLDER [--only core ...] [--ends 27] [--jobs 2] [--again REPORT]

mutmut changes one thing at a time (an operator, a number, a default, an argument) in copies of the
repository under FOLDER and runs the tests of ``GROUPS`` that reach the changed function. Printed
are how many changes each file's tests saw, and every change that none of them saw. A second call
goes on where the first was stopped. ``--ends 5`` tries every tenth change. Needs
``pip install -e '.[mutate]'``.
"""

import argparse
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[1]
SEEN = ("killed", "timeout", "caught by type check", "segfault", "suspicious")
COPIED = ("tests", "examples", "configs", "README.md")


@dataclass(frozen=True)
class Group:
    """Files to be broken, and the tests that must see it."""

    files: str
    tests: str
    filters: str = ""
    """Of the tests that all filters pass, those of filters with these words in their names."""


CONTRACT = ("contract", "contract_values", "contract_shapes", "unseen", "arguments")
GROUPS = {
    "core": Group(
        "so3 timeline missing",
        "so3 timeline missing operations bilateral wrong_ways representation confidence",
        "bilateral lifting-haar",
    ),
    "bvh": Group("io/bvh", "bvh bvh_writing bvh_not_written files"),
    "windows": Group(
        "filters/_lee_shin* filters/bilateral filters/linear filters/_masks filters/_bandwidth",
        "bilateral linear anisotropy operations",
        "gaussian linear bilateral",
    ),
    "nonlocal": Group(
        "filters/nonlocal_means filters/_patches",
        "nonlocal_means operations",
        "nonlocal",
    ),
    "competitors": Group(
        "filters/butterworth filters/savitzky_golay filters/robust filters/one_euro "
        "filters/tracking filters/_gains filters/subspace filters/_spectra filters/_chart "
        "filters/moving_mean",
        "competitors subspace confidence",
        "butterworth savitzky median hampel one-euro kalman principal kernel moving-mean",
    ),
    "wavelets": Group(
        "filters/lifting filters/learned filters/_haar filters/_thresholds filters/shrinkage "
        "filters/editing filters/_prediction",
        "lifting shrinkage learned editing",
        "lifting",
    ),
    "spectra": Group(
        "filters/_local_spectra filters/spectral filters/_overlap "
        "filters/_whitened filters/_hankel filters/low_rank filters/_correlation filters/_mixing "
        "filters/_mixture filters/_moving_frame filters/auto",
        "spectral low_rank mixture auto correlation anisotropy sigma moving_frame",
        "local-spectrum low-rank auto",
    ),
    "repair": Group(
        "filters/_outliers filters/_pops filters/_kriging filters/_rows filters/repair",
        "repair pops",
        "repair",
    ),
}


def settings(group: Group) -> str:
    """What mutmut reads in ``pyproject.toml``."""
    tests = [*group.tests.split(), *(CONTRACT if group.filters else ())]
    # mutmut calls the changed functions by way of its own, which then stand for the caller
    others = "not (test_contract or test_unseen or test_arguments or line_of_the_caller)"
    of_these = " or ".join([others, *group.filters.split()])
    listed = {
        "source_paths": ["torchquat"],
        "only_mutate": [f"torchquat/{name}.py" for name in group.files.split()],
        "also_copy": list(COPIED),
        "pytest_add_cli_args_test_selection": [f"tests/test_{name}.py" for name in tests],
        "pytest_add_cli_args": ["-k", of_these],
        # one that runs tests first would hand on what they left in caches
        "process_isolation": "forkserver",
    }
    return "\n[tool.mutmut]\n" + "".join(
        f"{key} = {json.dumps(value)}\n" for key, value in listed.items()
    )


def copy(folder: Path, group: Group) -> None:
    """Make a copy of what is committed, unless there is one."""
    if folder.exists():
        return
    subprocess.run(["git", "clone", "-q", str(ROOT), str(folder)], check=True)
    with (folder / "pyproject.toml").open("a", encoding="utf-8") as project:
        project.write(settings(group))


def mutmut(folder: Path, *arguments: str) -> str:
    """Run it there, and return what it printed."""
    command = [sys.executable, "-m", "mutmut", *arguments]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


def outcomes(folder: Path) -> dict[str, str]:
    """Changes that were tried: their names, and how their tests ended."""
    lines = re.findall(r"^\s*(\S+): (.+)$", mutmut(folder, "results", "--all", "true"), re.M)
    return {name: how for name, how in lines if how != "not checked"}


def changed(folder: Path, name: str) -> str:
    """The lines of one change."""
    shown = mutmut(folder, "show", name).splitlines()
    lines = [line for line in shown if re.match(r"[-+](?![-+]{2})", line)]
    return "\n".join([f"  {name}", *(f"    {line}" for line in lines)])


def report(folder: Path) -> str:
    """A line for each file, then what was not seen."""
    counts: defaultdict[str, Counter[bool]] = defaultdict(Counter)
    found = outcomes(folder)
    for name, how in found.items():
        counts[re.split(r"\.x[_ǁ]", name)[0]][how in SEEN] += 1
    lines = [
        f"{module:<36}{count.total():>6} changes {count[True]:>6} seen "
        f"{100 * count[True] / count.total():>6.1f} %"
        for module, count in sorted(counts.items())
    ]
    missed = [name for name, how in found.items() if how not in SEEN]
    return "\n".join([*lines, *(f"{changed(folder, name)} ({found[name]})" for name in missed)])


def unseen(path: Path, group: Group) -> list[str]:
    """Changes of a group that a printed report lists."""
    names = re.findall(r"^  (torchquat\S+)$", path.read_text(encoding="utf-8"), re.M)
    files = [f"torchquat.{name.replace('/', '.')}.*" for name in group.files.split()]
    return [name for name in names if any(fnmatch(name, pattern) for pattern in files)]


def main() -> int:
    """Try the groups in turn."""
    parser = argparse.ArgumentParser(description="Do the tests see the package broken?")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=GROUPS, nargs="+", default=list(GROUPS))
    parser.add_argument("--ends", default="0123456789", help="last digits of changes to try")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--again", type=Path, help="only what this former report lists as not seen")
    parser.add_argument("--report", action="store_true", help="only print what was found before")
    arguments = parser.parse_args()
    for name in arguments.only:
        folder = arguments.folder / name
        copy(folder, GROUPS[name])
        if not arguments.report:
            names = unseen(arguments.again, GROUPS[name]) if arguments.again else []
            run = ["run", "--max-children", str(arguments.jobs)]
            command = [sys.executable, "-m", "mutmut", *run, *(names or [f"*[{arguments.ends}]"])]
            subprocess.run(command, cwd=folder, check=True)
        print(f"{name}\n{report(folder)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
