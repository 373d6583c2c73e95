"""The command line: `holdfast solve | diagnose | simulate | view | plot | export | export-c | ...`.

Exit codes: 0 success; 2 bad input; 3 the physics does not permit the result, or nothing was solved; 70 a fault of this
program; 71 not enough memory; 74 stdout cannot be written; 130 interrupted; 141 stdout is a closed pipe.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

from holdfast.cli.streams import EXIT_OUTPUT, EXIT_READER_GONE, WatchedStdout, open_streams, say
from holdfast.errors import ClosureError, HoldfastError, MethodNotApplicable, SingularChainError

EXIT_BAD_INPUT, EXIT_REFUSED, EXIT_FAULT, EXIT_NO_MEMORY, EXIT_INTERRUPTED = 2, 3, 70, 71, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Every `HoldfastError` is printed as one line on stderr. So is any other exception, which is a fault of this program;
    the line then names the place in the code. With HOLDFAST_TRACEBACK=1 in the environment, the traceback is printed
    too.

    Args:
        argv: arguments after the program's name; by default those of the process.
    """
    if not open_streams():
        complain("stdout: is closed; try >/dev/null")
        return EXIT_OUTPUT
    with WatchedStdout() as stdout:
        code = _run(argv, stdout)
    if stdout.fault is None:
        return code
    if isinstance(stdout.fault, BrokenPipeError):
        return EXIT_READER_GONE
    complain(f"stdout: cannot be written: {stdout.fault.strerror or stdout.fault}")
    return EXIT_OUTPUT


def _run(argv: Sequence[str] | None, stdout: WatchedStdout) -> int:
    """Run one command."""
    try:
        from holdfast.cli.commands import run

        return run(list(sys.argv[1:] if argv is None else argv))
    except HoldfastError as error:
        complain(str(error))
        impossible = isinstance(error, ClosureError | MethodNotApplicable | SingularChainError)
        return EXIT_REFUSED if impossible else EXIT_BAD_INPUT
    except KeyboardInterrupt:
        complain("interrupted")
        return EXIT_INTERRUPTED
    except MemoryError:
        complain("not enough memory; try fewer samples, frames or joints")
        return EXIT_NO_MEMORY
    except Exception as fault:
        return _report(fault) if stdout.fault is None else EXIT_OUTPUT


def complain(problem: str) -> None:
    """Print an error as one line on stderr, if stderr can be written."""
    say(f"holdfast: error: {' '.join(problem.split())}")


def _report(fault: Exception) -> int:
    """Report an exception other than a `HoldfastError`, with its place in the code."""
    if os.environ.get("HOLDFAST_TRACEBACK"):
        say(traceback.format_exc())
    root = Path(__file__).parent.parent
    frames = [f for f in traceback.extract_tb(fault.__traceback__) if Path(f.filename).is_relative_to(root)]
    last = frames[-1]
    place = f"{Path(last.filename).relative_to(root).as_posix()}:{last.lineno}"
    complain(
        f"internal fault at {place}: {type(fault).__name__}: {str(fault)[:300]}; please report this line and the"
        " command (HOLDFAST_TRACEBACK=1 shows more)"
    )
    return EXIT_FAULT
