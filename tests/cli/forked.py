"""The real program many times over, in forks of one process that has its imports behind it."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

SERVER = """
import importlib, json, os, signal, sys, traceback
import holdfast.cli.commands, holdfast.cli.solve, holdfast.cli.simulate, holdfast.cli.view, holdfast.cli.diagnose
import holdfast.cli.results, holdfast.cli.sweep, holdfast.cli.export_c

for name in sys.argv[1:]:
    importlib.import_module(name)
for case in json.load(sys.stdin):
    out, err = (os.open(case["name"] + "." + end, os.O_CREAT | os.O_WRONLY | os.O_TRUNC) for end in ("out", "err"))
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0), os.dup2(out, 1), os.dup2(err, 2)
        os.environ.update(case["environment"])
        for name in case["unset"]:
            os.environ.pop(name, None)
        os.chdir(case["folder"])
        for name in case["missing"]:
            for known in [one for one in sys.modules if one.split(".")[0] == name]:
                del sys.modules[known]
            sys.modules[name] = None
        signal.alarm(90)  # a try that waits for ever is one that fails
        sys.argv = ["holdfast", *case["arguments"]]
        code = 1
        try:
            code = holdfast.cli.main()
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(code)
    os.close(out), os.close(err)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@dataclass(frozen=True)
class Try:
    """A call of the program.

    Attributes:
        arguments: its command line.
        folder: where it is called, in the test's folder.
        environment, unset: changes of the environment.
        missing: packages that are not installed.
    """

    arguments: list[str]
    folder: str = "."
    environment: dict[str, str] = field(default_factory=dict)
    unset: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ended:
    """How it ended.

    Attributes:
        code: its exit code.
        out, err: what it said.
    """

    code: int
    out: str
    err: str


def run_all(tries: list[Try], folder: Path, *imported: str) -> list[Ended]:
    """Return how each try ended; modules that are imported once save each try the time."""
    names = [str(folder / f"{k:03d}") for k in range(len(tries))]
    told = [
        asdict(one) | {"name": name, "folder": str(folder / one.folder)} for one, name in zip(tries, names, strict=True)
    ]
    command = [sys.executable, "-c", SERVER, *imported]
    done = subprocess.run(command, input=json.dumps(told), capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    codes = map(int, done.stdout.split())
    return [
        Ended(code, *(Path(f"{name}.{end}").read_text(errors="replace") for end in ("out", "err")))
        for code, name in zip(codes, names, strict=True)
    ]
