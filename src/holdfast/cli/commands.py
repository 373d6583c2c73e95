"""The commands and options of the command line; each command is implemented in the file of its name."""

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
ResultFolders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT ...")]
Changes = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(name="set", metavar="KEY=VALUE")]
Swept = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE|FOLDER")]
Targets = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RESULT|SCENE ...")]
OutFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Seconds = Annotated[float | None, tyro.conf.arg(metavar="SECONDS")]
OptionalName = Annotated[str | None, tyro.conf.arg(metavar="NAME")]
Names = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME")]
Format = Literal["table", "json"]
TableFormat = Literal["csv", "parquet", "mcap"]
Switch = tyro.conf.FlagCreatePairsOff[bool]


def solve(
    file: CaseFile,
    case: OptionalName = None,
    method: Name = "sequential",
    format: Format = "table",
    json: Switch = False,
) -> int:
    """Solve forward dynamics problems: joint accelerations, grasp forces, object acceleration.

    Args:
        file: problem cases, JSON; - for stdin.
        case: solve only this one.
        method: an algorithm (`holdfast methods` lists them), or `all`.
        format: a table, or one JSON document.
        json: the same as --format json.
    """
    from holdfast.cli import solve as command

    return command.solve(file, case, method, "json" if json else format)


def diagnose(
    file: Diagnosed,
    case: OptionalName = None,
    format: Format = "table",
    json: Switch = False,
    changes: Changes = (),
    trust_xacro: Switch = False,
) -> int:
    """Report mobility, rank, lost directions and indeterminate forces of a scene's initial state, or of problem cases.

    Args:
        file: a scene (.toml), or problem cases (JSON); - for stdin.
        case: diagnose only this one.
        format: a report as text (table), or one JSON document.
        json: the same as --format json.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import diagnose as command

    return command.diagnose(file, case, "json" if json else format, trust_xacro, changes)


def simulate(
    scene: SceneFile,
    out: Folder = None,
    overwrite: bool = False,
    resume: Switch = False,
    plots: bool = True,
    sample_time: Seconds = None,
    delay: Seconds = None,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Simulate a scene and write a result folder.

    Args:
        scene: the scene, TOML; - for stdin.
        out: the result folder to write.
        overwrite: replace an existing result folder.
        resume: continue a run that was interrupted or killed; the result is identical to the bit.
        plots: draw the plots too (needs matplotlib); `holdfast plot` draws them later.
        sample_time: sample time of the controller, whose torques are held in between; by default the scene's.
        delay: delay from a sample until its torques act; by default the scene's.
        changes: set a key of the scene, such as simulation.step=0.001 or arms.left.q="[0, 0.5]"; may be repeated.
        json: print one JSON document instead of the summary table.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import simulate as command

    return command.simulate(scene, out, overwrite, plots, resume, trust_xacro, sample_time, delay, changes, json)


def sweep(
    target: Swept,
    out: Folder = None,
    workers: int = 1,
    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
    run: Annotated[int | None, tyro.conf.arg(metavar="NUMBER")] = None,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Run or continue the sweep that a scene describes: many runs, whose results are written to a folder.

    Args:
        target: a scene with a [sweep] table, - for stdin; or the folder of a sweep.
        out: the folder of the scene's sweep; runs that it already contains are not repeated.
        workers: number of processes on this computer.
        cluster: address of a Dask scheduler, tcp://...; or local for a Dask cluster of these workers.
        run: repeat only this run, and write it as a result folder inside the sweep's, for view and plot.
        changes: set a key of the scene, such as sweep.count=1000; may be repeated.
        json: print one JSON document instead of tables.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import sweep as command

    return command.sweep(target, out, workers, cluster, run, changes, json, trust_xacro)


def export(
    results: ResultFolders = (),
    format: TableFormat = "csv",
    out: OutFile = None,
    overwrite: bool = False,
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Write runs as tables, for pandas, Excel, Matlab and others, or as ROS 2 messages.

    Args:
        results: the result folders.
        format: csv; parquet (pip install 'holdfast[parquet]'); mcap, ROS 2 messages (pip install 'holdfast[ros]').
        out: the file to write, - for stdout; by default trajectory.csv, .parquet or .mcap in the result folder.
        overwrite: replace existing files.
        json: print one JSON document instead of lines.
        trust_xacro: as for `plot`; only MCAP files need the robots.
    """
    from holdfast.cli import results as command

    return command.export(results, format, out, overwrite, trust_xacro, json)


def export_c(
    scene: SceneFile,
    out: Folder = None,
    name: OptionalName = None,
    function: Names = (),
    target: Literal["x86-64-v2", "x86-64-v3", "x86-64-v4", "aarch64"] = "x86-64-v3",
    source: Switch = False,
    scheme: Literal["rk4", "midpoint", "imex"] = "rk4",
    of: Names = (),
    by: Names = (),
    overwrite: bool = False,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Write a scene's dynamics, a time step and its controller as C or object files that run without Python.

    Args:
        scene: the scene, TOML; - for stdin.
        out: the folder to write; by default code/<scene>.
        name: prefix of all names in C; by default the scene's name.
        function: one of forward_dynamics, inverse_dynamics, project, step, control (the scene's controller),
            forward_dynamics_jacobian and others, which the documentation lists; may be repeated.
        target: the processor of the Linux system for which object files are compiled.
        source: write C11 instead of an object file.
        scheme: integration scheme of a step; imex for joints with stiff springs or dampers.
        of: a result to differentiate, by default qdd; may be repeated.
        by: an argument by which to differentiate, by default q, qd and tau; may be repeated.
        overwrite: replace an earlier export.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        json: print one JSON document instead of a table.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import export_c as command

    arguments = of or ("qdd",), by or ("q", "qd", "tau")
    return command.export_code(
        scene, out, name, function, target, source, scheme, *arguments, overwrite, changes, json, trust_xacro
    )


def summary(results: ResultFolders = (), json: Switch = False, trust_xacro: Switch = False) -> int:
    """Print the summaries of runs: closure, energy, momentum, peak wrenches, margins, events.

    Args:
        results: the result folders.
        json: print one JSON document instead of tables.
        trust_xacro: as for `plot`.
    """
    from holdfast.cli import results as command

    return command.summary(results, trust_xacro, json)


def plot(results: ResultFolders = (), out: Folder = None, json: Switch = False, trust_xacro: Switch = False) -> int:
    """Draw the figures of a run: wrenches, margins, torques, load share, closure and energy; or compare several runs.

    Args:
        results: the result folder; of several, the runs are drawn over each other.
        out: the folder for the figures; without it the result folder, or results/comparison for several.
        json: print one JSON document instead of lines.
        trust_xacro: expand the xacro files of a result of holdfast 0.1, which does not contain its robots.
    """
    from holdfast.cli import results as command

    return command.plot(results, out, trust_xacro, json)


def view(
    targets: Targets = (),
    export: OutFile = None,
    port: int = 0,
    rate: float = 30.0,
    overwrite: bool = False,
    changes: Changes = (),
    json: Switch = False,
    trust_xacro: Switch = False,
) -> int:
    """Show a run, or the initial state of a scene, in the browser; Ctrl-C ends it.

    Args:
        targets: a result folder, or a scene file, - for a scene on stdin; of several, one is chosen in the page.
        export: write one HTML file that can be opened from disk instead; - for stdout.
        port: the port of the viewer, on this machine only; 0 for any free port.
        rate: number of frames shown per second of the run.
        overwrite: replace an existing HTML file.
        changes: set a key of the scene, such as simulation.step=0.001; may be repeated.
        json: print one JSON document instead of lines.
        trust_xacro: expand xacro files that the scene names; that runs the Python in them.
    """
    from holdfast.cli import view as command

    return command.view(targets, export, port, rate, overwrite, trust_xacro, changes, json)


def bench(json: Switch = False, quick: Switch = False) -> int:
    """Compare the speed of forward dynamics with other libraries, which must give the same results.

    Args:
        json: print one JSON document instead of tables.
        quick: measure only a few small sizes, in half a minute instead of several minutes.
    """
    from holdfast.cli import bench as command

    return command.bench(json, quick)


def methods(json: Switch = False) -> int:
    """List the forward dynamics algorithms, with their equation, cost and applicability.

    Args:
        json: print one JSON document instead of a table.
    """
    from rich.table import Table

    from holdfast.cli.console import print_document, stdout
    from holdfast.dynamics.methods import METHODS

    if json:
        keys = ("name", "equation", "cost", "applies")
        print_document([{key: getattr(method, key) for key in keys} for method in METHODS.values()])
        return 0
    table = Table("method", "equation", "cost", "applies to")
    for method in METHODS.values():
        table.add_row(method.name, method.equation, method.cost, method.applies)
    console = stdout()
    console.print(table)
    console.print("n joints in all, l arms, N joints an arm; 'sequential' is the default")
    return 0


def doctor(json: Switch = False) -> int:
    """Report versions, processor features and optional packages.

    Args:
        json: print one JSON document instead of a table.
    """
    from holdfast.cli import doctor as command

    return command.doctor(json)


COMMANDS: dict[str, Callable[..., int]] = {
    command.__name__.replace("_", "-"): command
    for command in (solve, diagnose, simulate, sweep, summary, plot, view, export, export_c, bench, methods, doctor)
}


def run(arguments: list[str]) -> int:
    """Parse the arguments, run the command, and return its exit code.

    Raises:
        HoldfastError: the command or its input is invalid.
    """
    if arguments == ["--version"]:
        import holdfast

        print(holdfast.__version__)
        return 0
    for argument in arguments:
        if not argument or "\0" in argument or (argument.startswith("--") and argument.endswith("=")):
            raise SceneError(f"expected a name that is not empty and contains no NUL, got {argument!r}")
    first = arguments[0] if arguments else "--help"
    if not first.startswith("-") and first not in COMMANDS:
        raise SceneError(f"no command {first!r}.{checks.did_you_mean(first, COMMANDS)}")
    _refuse_repeated(arguments)
    call = _parsed(arguments or ["--help"])
    return call if isinstance(call, int) else call()


_REPEATABLE = ("--set", "--function", "--of", "--by")


def _refuse_repeated(arguments: list[str]) -> None:
    """Refuse an option that is given twice, including contradictory ones such as `--plots` and `--no-plots`.

    Raises:
        SceneError: an option is repeated; the message names it and its values.
    """
    given: dict[str, list[str]] = {}
    for k, argument in enumerate(arguments):
        if argument == "--":
            break
        if not argument.startswith("--") or argument.partition("=")[0] in _REPEATABLE:
            continue
        name, equals, value = argument.partition("=")
        after = arguments[k + 1] if not equals and k + 1 < len(arguments) else ""
        shown = f"{name} {value or ('' if after.startswith('--') else after)}".strip()
        given.setdefault(name[2:].removeprefix("no-").replace("_", "-"), []).append(shown)
    for name, times in given.items():
        if len(times) > 1:
            raise SceneError(f"--{name}: expected once, got {' and '.join(times)}; try one of them, or two commands")


def _parsed(arguments: list[str]) -> Callable[[], int] | int:
    """Return the call for the arguments, or an exit code if there is nothing to call."""
    boxed = io.StringIO()
    try:
        with contextlib.redirect_stderr(boxed):
            return tyro.extras.subcommand_cli_from_dict(
                {name: _later(command) for name, command in COMMANDS.items()},
                prog="holdfast",
                description="Exact dynamics for several robot arms that jointly grasp one object.",
                args=arguments,
            )
    except SystemExit as finished:
        if not finished.code:
            return 0
        complain(_unboxed(boxed.getvalue()))
        return BAD_INPUT


def _unboxed(message: str) -> str:
    """Return tyro's message without its title (the first line), its frame and its horizontal lines."""
    _, _, text = message.strip().partition("\n")
    return re.sub(r"[─│╭╮╰╯]+|-{4,}", " ", text or message)


def _later(command: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """Return a function of the same signature that only prepares the call."""

    @functools.wraps(command)
    def prepared(*arguments: object, **options: object) -> Callable[[], int]:
        return functools.partial(command, *arguments, **options)

    return prepared
