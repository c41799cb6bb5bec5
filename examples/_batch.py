"""Which files a command reads, and where each result goes."""

import glob
import os
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from torchquat.io.files import FORMATS

__all__ = ["ESTIMATORS", "Task", "plan", "shard"]

PICKLES = (".pkl",)
ESTIMATORS = (".pt", *PICKLES)
READ = (*FORMATS, *ESTIMATORS)


class Task(NamedTuple):
    """One file to read, and the file to write.

    Attributes:
        source: To read.
        target: To write.
        place: The target's place in the output folder.
    """

    source: Path
    target: Path
    place: Path


def plan(inputs: Sequence[str], output: Path, *, pickles: bool = False) -> list[Task]:
    """Find all inputs and give each an output.

    Args:
        inputs: Files, folders (searched through) or globs.
        output: A file for one input file, else a folder that mirrors the inputs.
        pickles: Whether folders and globs are searched for pickles, too.

    Raises:
        ValueError: If an input is missing or holds no motion file, or two have one output.
    """
    for text in inputs:
        if not Path(text).exists() and not glob.has_magic(text):
            raise ValueError(f"{text}: no such file or folder")
        if Path(text).is_file() and not _ends_in(Path(text), READ):
            raise ValueError(f"{text}: expected a name that ends in {' or '.join(READ)}")
    _resolved.cache_clear()  # links may have changed
    one_file = len(inputs) == 1 and Path(inputs[0]).is_file() and not output.is_dir()
    if one_file and output.suffix.lower() in READ:
        return [Task(Path(inputs[0]), output, Path(output.name))]
    if output.exists() and not output.is_dir():
        raise ValueError(f"{output}: expected a folder for {', '.join(inputs)}, got a file")
    tasks: dict[Path, Task] = {}
    for text in inputs:
        endings = READ if pickles else (*FORMATS, ".pt")
        found = list(_find(text, output, endings))
        if not found:
            raise ValueError(f"{text}: expected files in {' or '.join(endings)}, got none")
        for source, place in found:
            task = Task(source, output / place, place)
            _check_inside(task, output)
            twin = tasks.setdefault(_key(task.target), task)
            if twin is not task and twin.source.resolve() != source.resolve():
                raise ValueError(f"{task.target}: {twin.source} and {source} would both go there")
    return list(tasks.values())


def _find(text: str, output: Path, endings: Sequence[str]) -> Iterator[tuple[Path, Path]]:
    """Files of one input, and their places below the output folder."""
    path = Path(text)
    if path.is_file():
        yield path, Path(path.name)
        return
    base = path if path.is_dir() else _fixed_part(path)
    sources = _walk(path) if path.is_dir() else base.glob(str(path.relative_to(base)))
    for source in sorted(sources):
        # results of an earlier run inside the input folder are no inputs
        made = _resolved(source.parent).is_relative_to(_resolved(output))
        if not made and _ends_in(source, endings):
            yield source, source.relative_to(base)


def _walk(folder: Path) -> Iterator[Path]:
    """All files below a folder, and below those that links lead to, each folder once.

    Raises:
        OSError: If a folder cannot be read.
    """
    seen = set[Path]()
    for place, folders, names in os.walk(folder, onerror=_refuse, followlinks=True):
        if _resolved(Path(place)) in seen:
            folders.clear()
            continue
        seen.add(_resolved(Path(place)))
        folders.sort()
        yield from (Path(place, name) for name in names)


def _refuse(error: OSError) -> None:
    raise error


def _check_inside(task: Task, output: Path) -> None:
    """Raise if a link leads a result out of the output folder."""
    folder = _resolved(task.target.parent)
    target = task.target.resolve() if task.target.is_symlink() else folder / task.target.name
    if not target.is_relative_to(_resolved(output)):
        raise ValueError(f"{task.target}: expected a place in {output}, got a link out of it")


@lru_cache(maxsize=1024)
def _resolved(folder: Path) -> Path:
    return folder.resolve()


def shard(tasks: Sequence[Task], part: str | None) -> list[Task]:
    """The tasks of one of several machines.

    Args:
        tasks: All, in the same order on every machine.
        part: ``I/N``: the I-th of N parts, from 1; ``None``: all.

    Raises:
        ValueError: If ``part`` is no such pair.
    """
    if part is None:
        return list(tasks)
    match = re.fullmatch(r"(\d+)/(\d+)", part.strip())
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"shard must be I/N with 1 <= I <= N, got {part!r}.")
    return list(tasks[int(match[1]) - 1 :: int(match[2])])


def _ends_in(path: Path, endings: Sequence[str]) -> bool:
    """A link that leads nowhere does, too: it is named when its turn comes."""
    return path.suffix.lower() in endings and (path.is_file() or not path.exists())


def _fixed_part(pattern: Path) -> Path:
    """The folder above the first part with a wildcard."""
    parts = []
    for part in pattern.parts[:-1]:
        if glob.has_magic(part):
            break
        parts.append(part)
    return Path(*parts)


def _key(target: Path) -> Path:
    """Equal for names that are one file on systems which do not tell capitals apart."""
    return _resolved(target.parent) / target.name.lower()
