"""The command line: `holdfast solve | diagnose | simulate | view | plot | export | bench | ...`.

Exit codes: 0; 2 bad input; 3 physics refused, or nothing was solved; 130 interrupted.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence

BAD_INPUT, REFUSED, INTERRUPTED = 2, 3, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Every `HoldfastError` becomes one line on stderr; other exceptions are faults of this
    program and are not hidden.

    Args:
        argv: arguments after the program's name; default: those of the process.
    """
    from holdfast.cli.commands import run
    from holdfast.errors import ClosureError, HoldfastError, MethodNotApplicable, SingularChainError

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # letters that a terminal lacks are escaped, not fatal
            stream.reconfigure(errors="backslashreplace")
    try:
        code = run(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
        return code
    except HoldfastError as error:
        complain(str(error))
        return REFUSED if isinstance(error, (ClosureError, MethodNotApplicable, SingularChainError)) else BAD_INPUT
    except KeyboardInterrupt:
        complain("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # whoever read stdout has seen enough; without this the interpreter would complain while it exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def complain(problem: str) -> None:
    """Print one line on stderr."""
    print("holdfast: error:", " ".join(problem.split()), file=sys.stderr)
