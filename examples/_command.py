"""What the example commands share: arguments in, one line out where something is wrong."""

import io
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from jsonargparse import ArgumentError, ArgumentParser, Namespace

__all__ = ["one_line", "run"]


def run(parser: ArgumentParser, argv: Sequence[str] | None, job: Callable[[Namespace], int]) -> int:
    """Parse arguments and do the job.

    Args:
        parser: Made with ``exit_on_error=False``.
        argv: Arguments; ``None``: those of the process.
        job: Returns the exit status.

    Returns:
        The exit status: 2 where the arguments are wrong, 1 where the job failed, 130 where it was
        interrupted or asked to end.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name that it cannot show must not stop it
            stream.reconfigure(errors="backslashreplace")
    try:
        arguments = parser.parse_args(None if argv is None else list(argv))
    except ArgumentError as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 2
    try:
        with _termination_interrupts():
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


@contextmanager
def _termination_interrupts() -> Iterator[None]:
    """A request to end does what an interrupt does, which leaves nothing half done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)
