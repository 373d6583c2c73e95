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

from holdfast.cli import streams
from holdfast.errors import ClosureError, HoldfastError, MethodNotApplicable, SingularChainError
from holdfast.names import is_numeric_failure, numeric_failure


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Every `HoldfastError` is printed as one line on stderr. So is any other exception, which is a fault of this program;
    the line then names the place in the code. With HOLDFAST_TRACEBACK=1 in the environment, the traceback is printed
    too.

    Args:
        argv: arguments after the program's name; by default those of the process.
    """
    if not streams.open_streams():
        streams.complain("stdout: is closed; try >/dev/null")
        return streams.EXIT_OUTPUT
    with streams.WatchedStdout() as stdout:
        code = _run(argv, stdout)
    if stdout.fault is None:
        return code
    if isinstance(stdout.fault, BrokenPipeError):
        return streams.EXIT_READER_GONE
    streams.complain(f"stdout: cannot be written: {stdout.fault.strerror or stdout.fault}")
    return streams.EXIT_OUTPUT


def _run(argv: Sequence[str] | None, stdout: streams.WatchedStdout) -> int:
    """Run one command."""
    try:
        from holdfast.cli.commands import run

        return run(list(sys.argv[1:] if argv is None else argv))
    except HoldfastError as error:
        streams.complain(str(error))
        impossible = isinstance(error, ClosureError | MethodNotApplicable | SingularChainError)
        return streams.EXIT_REFUSED if impossible else streams.EXIT_BAD_INPUT
    except KeyboardInterrupt:
        streams.complain("interrupted")
        return streams.EXIT_INTERRUPTED
    except MemoryError:
        streams.complain("not enough memory; try fewer samples, frames or joints")
        return streams.EXIT_NO_MEMORY
    except Exception as fault:
        if is_numeric_failure(fault):
            streams.complain(str(numeric_failure("input")))
            return streams.EXIT_BAD_INPUT
        return _report(fault) if stdout.fault is None else streams.EXIT_OUTPUT


def _report(fault: Exception) -> int:
    """Report an exception other than a `HoldfastError`, with its place in the code."""
    if os.environ.get("HOLDFAST_TRACEBACK"):
        streams.say(traceback.format_exc())
    root = Path(__file__).parent.parent
    frames = [f for f in traceback.extract_tb(fault.__traceback__) if Path(f.filename).is_relative_to(root)]
    last = frames[-1]
    place = f"{Path(last.filename).relative_to(root).as_posix()}:{last.lineno}"
    streams.complain(
        f"internal fault at {place}: {type(fault).__name__}: {str(fault)[:300]}; please report this line and the"
        " command (HOLDFAST_TRACEBACK=1 shows more)"
    )
    return streams.EXIT_FAULT
