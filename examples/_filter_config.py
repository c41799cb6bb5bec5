"""A filter by name and arguments, as configs and command lines give it."""

import importlib
import inspect
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from torch import nn

import torchquat

__all__ = ["FilterConfig", "filter_names", "find_config", "in_frames", "read_config", "shown"]

CONFIGS = Path(__file__).parents[1] / "configs"

TIMES = ("sigma_t", "radius", "patch_radius", "search_radius", "window")
"""Arguments in frames: ``25ms`` and ``0.1s`` are converted with the frame rate of the file.

Where whole frames are wanted, the nearest count is taken, but 1 at least for any time above 0.
"""

FREQUENCIES = ("cutoff", "min_cutoff", "d_cutoff")
"""Arguments in cycles per frame: ``6Hz`` is converted.

A filter that has a ``frame_rate`` is given that of the file, and takes them in Hz, with or without
the unit.
"""

TRIAL_RATE = 1000.0
"""Wrong values are found at this frame rate [1/s]: at a low one, right ones would be too short."""

_QUANTITY = re.compile(r"([+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?)\s*(ms|s|Hz)?")
_SECONDS = {"ms": 1e-3, "s": 1.0}


@dataclass(frozen=True)
class FilterConfig:
    """A class and its arguments, checked against its signature.

    Attributes:
        class_path: ``torchquat.BilateralFilter``, or a module of your own: ``package.Class``.
        init_args: Arguments of the constructor; times and cut-offs may carry a unit.
        origin: Where it was said, for errors.
    """

    class_path: str
    init_args: dict[str, Any] = field(default_factory=dict)
    origin: str = "command line"

    def __post_init__(self) -> None:
        valid = list(inspect.signature(self._class()).parameters)
        for key in self.init_args:
            if key not in valid:
                raise ValueError(
                    f"{self.origin}: filter.init_args.{key}: expected one of {', '.join(valid)}"
                )
        self.build(TRIAL_RATE)  # a wrong value is an error before the first file is read

    def build(self, frame_rate: float) -> nn.Module:
        """The filter for files of a frame rate [1/s].

        Raises:
            ValueError: If an argument is out of its range.
        """
        parameters = inspect.signature(self._class()).parameters
        given = dict(self.init_args)
        if "frame_rate" in parameters:
            given.setdefault("frame_rate", frame_rate)
        arguments = {}
        for key, value in given.items():
            try:
                arguments[key] = in_frames(key, value, frame_rate)
                in_hertz = key in FREQUENCIES and _QUANTITY.fullmatch(str(value).strip())
                if in_hertz and _has_unit(value) and "frame_rate" in parameters:
                    arguments[key] *= _number(given["frame_rate"])
            except ValueError as error:
                raise ValueError(f"{self.origin}: filter.init_args.{key}: {error}") from None
            if arguments[key] is not value and "int" in str(parameters[key].annotation):
                # a time too short for a frame is no wish for a filter that does nothing
                is_short = key in TIMES and _has_unit(value) and 0 < arguments[key] < 1
                arguments[key] = 1 if is_short else round(arguments[key])
        try:
            return self._class()(**arguments)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{self.origin}: {self.class_path}: {error}") from None

    def _class(self) -> type[nn.Module]:
        parts = self.class_path.split(".") if isinstance(self.class_path, str) else [""]
        if not all(part.isidentifier() for part in parts):  # ".torchquat" would be relative
            raise ValueError(
                f"{self.origin}: filter.class_path: expected a name, got {self.class_path!r}"
            )
        module, _, name = self.class_path.rpartition(".")
        try:
            found = getattr(importlib.import_module(module) if module else torchquat, name, None)
        except ImportError as error:
            raise ValueError(f"{self.origin}: filter.class_path: {error}") from None
        if not (isinstance(found, type) and issubclass(found, nn.Module)):
            raise ValueError(
                f"{self.origin}: filter.class_path: expected one of {', '.join(filter_names())}, "
                f"got {self.class_path!r}"
            )
        return found


def read_config(
    path: Path, class_path: str | None = None, init_args: Mapping[str, Any] | None = None
) -> FilterConfig:
    """Read a YAML file, and let the command line have the last word.

    Args:
        path: File with ``filter: {class_path: ..., init_args: {...}}``.
        class_path: Replaces the class; the arguments of the file are dropped with it.
        init_args: Replace single arguments.

    Raises:
        ValueError: If the file is no such YAML, or a key is unknown: names file, key, valid keys.
        OSError: If the file cannot be read.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: expected YAML: {' '.join(str(error).split())}") from None
    content = _mapping(path, "", content, ("filter",))
    section = _mapping(path, "filter", content["filter"], ("class_path", "init_args"))
    arguments = section.get("init_args") or {}
    if not isinstance(arguments, dict):
        raise ValueError(f"{path}: filter.init_args: expected a mapping, got {arguments!r}")
    arguments = dict(arguments)
    if class_path is not None and class_path != section["class_path"]:
        arguments = {}
    # what was said on the command line is not the file's fault
    origin = str(path) if class_path is None and not init_args else f"{path} and command line"
    return FilterConfig(
        class_path or section["class_path"], {**arguments, **(init_args or {})}, origin
    )


def find_config(name: str) -> Path:
    """The preset of this name, or a file: what happens to lie around does not hide a preset.

    Raises:
        ValueError: If there is neither.
    """
    presets = {path.stem: path for path in CONFIGS.glob("*.yaml")}
    path = presets.get(name, Path(name))
    if path.is_dir() or not path.exists():  # a pipe is as good as a file
        raise ValueError(f"{name}: expected a YAML file or one of {', '.join(sorted(presets))}")
    return path


def shown(config: FilterConfig) -> str:
    """A filter as YAML that :func:`read_config` takes."""
    section = {"class_path": config.class_path, "init_args": config.init_args}
    return yaml.safe_dump({"filter": section}, sort_keys=False)


def in_frames(key: str, value: Any, frame_rate: float) -> Any:
    """A time with a unit in frames, a cut-off with a unit in cycles per frame.

    Args:
        key: Name of the argument.
        value: A quantity as text, or anything else, which comes back as it is.
        frame_rate: Frames per second.

    Raises:
        ValueError: If the unit does not fit the argument.
    """
    match = _QUANTITY.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        return value
    number, unit = float(match[1]), match[2]
    if not math.isfinite(number):
        raise ValueError(f"expected a finite number, got {value!r}")
    if unit is None:
        return number
    if unit in _SECONDS and key in TIMES:
        return number * _SECONDS[unit] * frame_rate
    if unit == "Hz" and key in FREQUENCIES:
        return number / frame_rate
    wanted = "in ms or s" if key in TIMES else "in Hz" if key in FREQUENCIES else "without a unit"
    raise ValueError(f"expected a number {wanted}, got {value!r}")


def _number(frame_rate: Any) -> float:
    try:
        return float(frame_rate)
    except (TypeError, ValueError):
        raise ValueError(f"expected a number for frame_rate, got {frame_rate!r}") from None


def _has_unit(value: Any) -> bool:
    return isinstance(value, str) and not value.strip()[-1:].isdigit()


def _mapping(path: Path, name: str, content: Any, keys: tuple[str, ...]) -> dict[str, Any]:
    """A mapping that has the first of ``keys`` and no others."""
    place = f"{path}: {name}".rstrip(": ")
    if not isinstance(content, dict) or keys[0] not in content:
        raise ValueError(f"{place}: expected the key {keys[0]!r}")
    for key in content:
        if key not in keys:
            raise ValueError(f"{place}: expected one of {', '.join(keys)}, got the key {key!r}")
    return content


def filter_names() -> list[str]:
    """Names of all filters in the package: modules that take quaternions and their weight."""
    return [name for name in torchquat.__all__ if _is_filter(getattr(torchquat, name))]


def _is_filter(candidate: object) -> bool:
    if not (isinstance(candidate, type) and issubclass(candidate, nn.Module)):
        return False
    return list(inspect.signature(candidate.forward).parameters)[1:] == ["q", "weight"]
