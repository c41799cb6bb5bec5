"""A record of training: a CSV file always, TensorBoard's where its package is installed."""

import csv
from pathlib import Path

__all__ = ["Log"]

HEAD = ["step", "name", "value"]


class Log:
    """Scalars by step and name.

    Args:
        folder: Where ``scalars.csv`` and TensorBoard's files go.
        start: First step to come: what a former run wrote from there on is dropped.
    """

    def __init__(self, folder: Path, start: int = 0) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / "scalars.csv"
        kept = [row for row in _rows(self._path) if int(row[0]) < start]
        with self._path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([HEAD, *kept])
        self._board = _board(folder, start)

    def write(self, step: int, scalars: dict[str, float]) -> None:
        """Add values of one step."""
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([step, name, repr(x)] for name, x in scalars.items())
        if self._board is not None:
            for name, value in scalars.items():
                self._board.add_scalar(name, value, step)

    def close(self) -> None:
        """Write what is still on its way."""
        if self._board is not None:
            self._board.close()


def _rows(path: Path) -> list[list[str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))[1:]


def _board(folder: Path, start: int):
    """TensorBoard's writer; ``None`` where the extra "train" is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder), purge_step=start)
