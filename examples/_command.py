"""What the example commands share: arguments in, one line out where something is wrong."""

import sys
from collections.abc import Callable, Sequence

from jsonargparse import ArgumentError, ArgumentParser, Namespace

__all__ = ["one_line", "run"]


def run(parser: ArgumentParser, argv: Sequence[str] | None, job: Callable[[Namespace], int]) -> int:
    """Parse arguments and do the job.

    Args:
        parser: Made with ``exit_on_error=False``.
        argv: Arguments; ``None``: those of the process.
        job: Returns the exit status.

    Returns:
        The exit status: 2 where the arguments are wrong, 1 where the job failed.
    """
    try:
        arguments = parser.parse_args(None if argv is None else list(argv))
    except ArgumentError as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 2
    try:
        return job(arguments)
    except (ValueError, OSError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def one_line(error: BaseException) -> str:
    """What went wrong, without line breaks."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
