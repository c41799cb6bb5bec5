"""Filters that kill the process they run in, as the system does when memory runs out."""

import os
import signal
from pathlib import Path

from torchquat import GaussianFilter


class KillsOnce(GaussianFilter):
    """The first process that comes to a clip of a certain length dies.

    Args:
        mark: File that says that this has happened.
        frames: Length of that clip.
        always: Every process dies of it.
    """

    def __init__(self, mark: str, frames: int = 13, always: bool = False) -> None:
        super().__init__(1.0)
        self.mark, self.frames, self.always = Path(mark), frames, always

    def forward(self, q, weight=None):
        if len(q) == self.frames and (self.always or not self.mark.exists()):
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().forward(q, weight)
