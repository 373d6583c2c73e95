"""What the command line accepts; each command's work is in the file of its name."""

from __future__ import annotations

import contextlib
import functools
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import tyro

from holdfast.cli import BAD_INPUT, complain
from holdfast.errors import SceneError
from holdfast.model import checks

CaseFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
Diagnosed = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|FILE")]
SceneFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
Folder = Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")]
Name = Annotated[str, tyro.conf.arg(metavar="NAME")]
ResultFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")]
Target = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT|SCENE")]
OutFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
OptionalName = Annotated[str | None, tyro.conf.arg(metavar="NAME")]
Format = Literal["table", "json"]
TableFormat = Literal["csv", "parquet", "mcap"]
Switch = tyro.conf.FlagCreatePairsOff[bool]


def solve(file: CaseFile, case: OptionalName = None, method: Name = "sequential", format: Format = "table") -> int:
    """Solve forward dynamics problems: joint accelerations, grasp forces, object acceleration.

    Args:
        file: problem cases, JSON.
        case: solve only this one.
        method: an algorithm (`holdfast methods` lists them), or `all`.
        format: table to read, or json to process.
    """
    from holdfast.cli import solve as command

    return command.solve(file, case, method, format)


def diagnose(file: Diagnosed, case: OptionalName = None, format: Format = "table", trust_xacro: Switch = False) -> int:
    """Report mobility, rank, lost directions and indeterminate forces of a scene as it begins, or of problem cases.

    Args:
        file: a scene (.toml), or problem cases (JSON).
        case: diagnose only this one.
        format: words to read (table), or json to process.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import diagnose as command

    return command.diagnose(file, case, format, trust_xacro)


def simulate(
    scene: SceneFile,
    out: Folder = None,
    overwrite: bool = False,
    resume: Switch = False,
    plots: bool = True,
    sample_time: Seconds = None,
    delay: Seconds = None,
    trust_xacro: Switch = False,
) -> int:
    """Simulate a scene and write a result folder.

    Args:
        scene: the scene, TOML.
        out: the result folder to write.
        overwrite: replace an existing result folder.
        resume: go on with a run that was interrupted or killed, to the same bits.
        plots: draw the plots too (needs matplotlib); `holdfast plot` draws them later.
        sample_time: ask the controller once every so many seconds and hold its torques; the scene's without it.
        delay: seconds from a sample to when its torques act; the scene's without it.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import simulate as command

    return command.simulate(scene, out, overwrite, plots, resume, trust_xacro, sample_time, delay)


def export(
    result: ResultFolder,
    format: TableFormat = "csv",
    out: OutFile = None,
    overwrite: bool = False,
    trust_xacro: Switch = False,
) -> int:
    """Write a run as one table, for pandas, Excel, Matlab and others.

    Args:
        result: the result folder.
        format: csv, or parquet (needs pyarrow).
        out: the file to write; `trajectory.csv` or `.parquet` in the result folder without it.
        overwrite: replace an existing file.
        trust_xacro: as for `plot`; only MCAP files need the robot.
    """
    from holdfast.cli import results

    return results.export(result, format, out, overwrite, trust_xacro)


def plot(result: ResultFolder, out: Folder = None, trust_xacro: Switch = False) -> int:
    """Draw the figures of a run: wrenches, margins, torques, load share, closure and energy.

    Args:
        result: the result folder.
        out: the folder for the figures; the result folder without it.
        trust_xacro: for a result of holdfast 0.1, which kept no robots: expand its xacro files where they are now.
    """
    from holdfast.cli import results

    return results.plot(result, out, trust_xacro)


def view(
    target: Target,
    export: OutFile = None,
    port: int = 0,
    rate: float = 30.0,
    overwrite: bool = False,
    trust_xacro: Switch = False,
) -> int:
    """Show a run, or a scene as it begins, in the browser; Ctrl-C ends it.

    Args:
        target: a result folder, or a scene file.
        export: write one HTML file that opens from disk, instead.
        port: to serve at, on this machine only; 0 for any that is free.
        rate: moments a second of the run that are shown.
        overwrite: replace an existing HTML file.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import view as command

    return command.view(target, export, port, rate, overwrite, trust_xacro)


def bench(json: Switch = False, quick: Switch = False) -> int:
    """Compare the speed of forward dynamics with other libraries, at equal answers.

    Args:
        json: print one JSON document instead of tables.
        quick: a few small sizes, half a minute; the whole takes several minutes.
    """
    from holdfast.cli import bench as command

    return command.bench(json, quick)


def methods() -> int:
    """List the forward dynamics algorithms: equation, cost, where they apply."""
    from rich.table import Table

    from holdfast.cli.console import stdout
    from holdfast.dynamics.methods import METHODS

    table = Table("method", "equation", "cost", "applies to")
    for method in METHODS.values():
        table.add_row(method.name, method.equation, method.cost, method.applies)
    console = stdout()
    console.print(table)
    console.print("n joints in all, l arms, N joints an arm; 'sequential' is the default")
    return 0


def doctor() -> int:
    """Report versions, processor features and optional packages."""
    from holdfast.cli import doctor as command

    return command.doctor()


COMMANDS: dict[str, Callable[..., int]] = {
    command.__name__: command for command in (solve, diagnose, simulate, plot, view, export, bench, methods, doctor)
}


def run(arguments: list[str]) -> int:
    """Parse the arguments, run the command, return its exit code.

    Raises:
        HoldfastError: what the command refuses.
    """
    if arguments == ["--version"]:
        import holdfast

        print(holdfast.__version__)
        return 0
    for argument in arguments:
        if not argument or "\0" in argument or (argument.startswith("--") and argument.endswith("=")):
            raise SceneError(f"expected no empty name, and none with NUL in it, got {argument!r}")
    first = arguments[0] if arguments else "--help"
    if not first.startswith("-") and first not in COMMANDS:
        raise SceneError(f"no command {first!r}.{checks.did_you_mean(first, COMMANDS)}")
    _refuse_repeated(arguments)
    call = _parsed(arguments or ["--help"])
    return call if isinstance(call, int) else call()


def _refuse_repeated(arguments: list[str]) -> None:
    """Refuse an option that is given twice, also as `--plots` and `--no-plots`: only one of them could be obeyed.

    Raises:
        SceneError: naming the option and what it is given.
    """
    given: dict[str, list[str]] = {}
    for k, argument in enumerate(arguments):
        if argument == "--":
            break
        if not argument.startswith("--"):
            continue
        name, equals, value = argument.partition("=")
        after = arguments[k + 1] if not equals and k + 1 < len(arguments) else ""
        shown = f"{name} {value or ('' if after.startswith('--') else after)}".strip()
        given.setdefault(name[2:].removeprefix("no-").replace("_", "-"), []).append(shown)
    for name, times in given.items():
        if len(times) > 1:
            raise SceneError(f"--{name}: expected once, got {' and '.join(times)}; try one of them, or two commands")


def _parsed(arguments: list[str]) -> Callable[[], int] | int:
    """Return the call that the arguments ask for, or an exit code if there is nothing to call."""
    boxed = io.StringIO()
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.extras.subcommand_cli_from_dict(
                {name: _later(command) for name, command in COMMANDS.items()},
                prog="holdfast",
                description="Exact dynamics for robot arms that hold one object together.",
                args=arguments,
            )
    except SystemExit as finished:
        if not finished.code:
            return 0
        complain(_unboxed(boxed.getvalue()))
        return BAD_INPUT


def _unboxed(message: str) -> str:
    """Return tyro's message without its title (the first line), its frame and its rules."""
    _, _, text = message.strip().partition("\n")
    return re.sub(r"[─│╭╮╰╯]+|-{4,}", " ", text or message)


def _later(command: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """Return a function of the same signature that only prepares the call."""

    @functools.wraps(command)
    def prepared(*arguments: object, **options: object) -> Callable[[], int]:
        return functools.partial(command, *arguments, **options)

    return prepared
