"""Whatever a command is given: one line on stderr, the exit code that a shell expects, and nothing half-written."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from tests.cli.forked import Try, run_all
from tests.cli.test_commands import FILE, program
from tests.io.mutations import small_case
from tests.robots.mesh_files.written import stl_bytes
from tests.robots.two_armed import TWO_ARMED
from tests.scenario.test_robot import scene

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs fork and POSIX shells")

LONG = "x" * 300
SWEEP = """
[sweep]
count = 2
parameters.object_mass = { type = "uniform", low = 2.0, high = 4.0 }
parameters.object_inertia = "scale"
"""
MESHED = TWO_ARMED.replace("package://two_armed/finger.stl", "finger.stl")
# folders of a sweep with one file spoilt
SPOILT = {
    "cut_manifest": ("sweep.json", b'{"format": "holdfast-sweep", "format_ver'),
    "no_manifest": ("sweep.json", b"[]"),
    "listed_plan": ("sweep.json", b'{"format": "holdfast-sweep", "format_version": 1, "generic_rank": 3, "plan": []}'),
    "true_rank": ("sweep.json", b'{"format": "holdfast-sweep", "format_version": 1, "generic_rank": true, "plan": {}}'),
    "listed_robots": ("robots.json", b"[1]"),
    "robots_elsewhere": ("robots.json", b'{"left": {"file": "../../etc/passwd", "base": "a", "tip": "b"}}'),
    "no_robots": ("robots.json", b"{}"),
    "cut_scene": ("scene.toml", b"arms = ["),
    "another_scene": ("scene.toml", b"name = 1"),
    "bytes_scene": ("scene.toml", b"\xff\xfe"),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of scenes, cases, a result, and everything that is none."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "robots").mkdir()
    (folder / "robots" / "two.urdf").write_text(MESHED)
    (folder / "robots" / "finger.stl").write_bytes(stl_bytes()[:-7])
    (folder / "short.toml").write_text(scene(arm="q = [0.1, 1.1, 0.12]"))
    (folder / "swept.toml").write_text(scene(arm="q = [0.1, 1.1, 0.12]") + SWEEP)
    (folder / "cases.json").write_text(json.dumps([small_case()]))
    (folder / "latin.toml").write_bytes('name = "Prüfung"'.encode("latin-1"))
    (folder / "latin.json").write_bytes('{"name": "Prüfung"}'.encode("latin-1"))
    (folder / "zeros").write_bytes(b"\0" * 1000)
    (folder / "empty").write_bytes(b"")
    (folder / "deep.json").write_text("[" * 100_000)
    (folder / "a_folder").mkdir()
    (folder / "a_folder" / "something").touch()
    os.mkfifo(folder / "pipe")
    tries = [["simulate", "short.toml", "--out", "result", "--no-plots"], ["sweep", "swept.toml", "--out", "store"]]
    for done in run_all([Try(one) for one in tries], folder):
        assert done.code == 0, done.err
    shutil.copytree(folder / "result", folder / "broken")
    (folder / "broken" / "meta.json").write_bytes(b"\xff\xfe{}")
    for name, (file, content) in SPOILT.items():
        shutil.copytree(folder / "store", folder / name)
        (folder / name / file).write_bytes(content)
    return folder


def cases():
    """Return tries that are refused, and a part of what is said."""
    inputs = ("none", "a_folder", "latin.toml", "latin.json", "zeros", "empty", "deep.json", "pipe", "/dev/zero", LONG)
    for command in ("solve", "diagnose", "simulate", "view", "plot", "export", "sweep", "export-c"):
        # diagnose reads its file as solve does, export its folder as plot does, export-c its scene as sweep does
        few = command in ("diagnose", "export", "export-c")
        for given in ("none", "broken") if few else (*inputs, ".", "/", "broken"):
            yield Try([command, given]), ""
        yield Try([command, ""]), "expected"
        yield Try([command]), "Missing"
    for command in ("solve", "diagnose"):
        yield Try([command, "short.toml", "--case", "x"]), ""
        yield Try([command, FILE, "--case", LONG]), "no case"
        yield Try([command, FILE, "--format", "xml"]), "invalid choice"
    yield Try(["view", "nowhere"]), "nowhere: no such file or folder; expected a result folder or a scene file"
    yield Try(["export", "nowhere"]), "no such folder"
    yield Try(["view", "a_folder"]), "meta.json"
    yield Try(["plot", "a_folder"]), "meta.json"
    yield Try(["view", "result", "--export", "nowhere/page.html"]), "nowhere/page.html: cannot be written"
    yield Try(["plot", "result", "--out", "empty/in"]), "cannot be written"
    yield Try(["solve", FILE, "--method", "\x1b[31m"]), "no method"
    yield Try(["export", "result", "--format", "xlsx"]), "xlsx"
    yield Try(["solve", "short.toml"]), "holdfast simulate"
    yield Try(["simulate", "cases.json"]), "not valid TOML"
    for out in ("/", ".", "a_folder", "empty", "empty/under", LONG, "/proc/none", "/dev/null", "/dev/full", "pipe"):
        yield Try(["simulate", "short.toml", "--out", out, "--overwrite"]), ""
    for out in ("a_folder", "empty"):
        yield Try(["simulate", "short.toml", "--out", out]), ""
        yield Try(["export", "result", "--out", out]), ""
    for out in ("/", ".", "a_folder", "empty/under", LONG, "/proc/none", "none/under"):
        yield Try(["export", "result", "--out", out, "--overwrite"]), ""
        yield Try(["view", "result", "--export", out, "--overwrite"]), ""
    yield Try(["export", "result", "--format", "mcap", "--out", "none/under", "--overwrite"]), ""
    for out in ("empty", "empty/under", LONG, "/proc/none", "/dev/null"):
        yield Try(["plot", "result", "--out", out]), ""
    for command, option in (("simulate", "--out"), ("export", "--out"), ("plot", "--out"), ("view", "--export")):
        yield Try([command, "short.toml" if command == "simulate" else "result", option, ""]), "expected"
        yield Try([command, "short.toml" if command == "simulate" else "result", f"{option}="]), "expected"
    for port in ("-1", "99999", "65536", "x", "1e3", "9" * 30):
        yield Try(["view", "result", "--port", port]), "port"
    for rate, said in (("nan", ""), ("inf", ""), ("-1", ": expected > 0"), ("0", ": expected > 0"), ("x", "")):
        yield Try(["view", "result", "--rate", rate, "--export", "rate.html"]), f"rate{said}"
    yield Try(["simulate", "short.toml", "--resume", "--overwrite"]), "one of them"
    for command in ("solve", "diagnose", "simulate", "view", "sweep", "export-c"):
        yield Try([command, "-"]), "stdin" if command == "solve" else ""  # it is empty
    for command in ("simulate", "plot"):
        yield Try([command, "short.toml" if command == "simulate" else "result", "--out", "-"]), "single files only"
    for command in ("plot", "export", "summary"):
        yield Try([command, "result", "none"]), "none"
    yield Try(["export", "result", "result", "--out", "x"]), "expected one result folder, got 2"
    for command, option in (("plot", "--out"), ("view", "--export")):
        yield Try([command, "result", "result", option, "x"]), "expected different ones, got result twice"
    yield Try(["export", "result", "--out", "-", "--json"]), "one of them"
    yield Try(["view", "result", "--export", "-", "--json"]), "one of them"
    yield Try(["view", "result", "--set", "name=1"]), "expected a scene"
    yield Try(["diagnose", "cases.json", "--set", "name=1"]), "expected a scene"
    deep = ".".join("a" * 3000)
    for change, said in (
        ("simulation.stp=1", "Did you mean 'step'?"),
        ("simulaton.step=1", "Did you mean 'simulation'?"),
        ("arms.lft.q=1", "no 'lft' in arms"),
        ("arms.7.q=1", "no '7' in arms"),
        ("arms.\u0661.q=1", "in arms"),
        ("simulation.step.x=1", "expected a table or a list at simulation.step"),
        ("simulation.step=x", "expected a TOML value"),
        ("simulation.step=1\ny = 2", "expected a TOML value"),
        ("simulation.step=nan", "expected a finite number"),
        ("simulation.step=1979-01-01", "$.simulation.step"),
        ("=1", "expected key=value"),
        ("a..b=1", "expected key=value"),
        (deep, "expected key=value"),
        (f"{deep}=1", "levels"),
        ("name=" + "[" * 5000, "expected a TOML value"),
        ("\x1b[31m=1", "unknown field"),
    ):
        yield Try(["simulate", "short.toml", "--set", change]), said
    yield Try(["view", "short.toml", "--set", "simulation.stp=1"]), "Did you mean 'step'?"
    yield Try(["simulate", "short.toml", "--out", "result", "--resume"]), "nothing to resume"
    yield from of_sweeps()
    yield from of_exported_code()
    yield Try(["export", "result", "--format", "parquet"], missing=("pyarrow",)), "holdfast[parquet]"
    yield Try(["export", "result", "--format", "mcap"], missing=("mcap_ros2", "mcap")), "holdfast[ros]"
    yield Try(["plot", "result"], missing=("matplotlib",)), "holdfast[plot]"
    yield Try(["view", "result", "--export", "no.html"], missing=("viser",)), "holdfast[view]"


def of_sweeps():
    """Return tries of `sweep` that are refused, and a part of what is said."""
    yield Try(["sweep", "short.toml"]), "sweep: expected a table"
    yield Try(["sweep", "cases.json"]), "not valid TOML"
    for name, (file, _) in SPOILT.items():
        if file != "sweep.json":  # which the command writes again
            yield Try(["sweep", name]), ""
        yield Try(["sweep", name, "--run", "0"]), name
    for out in ("/", ".", "a_folder", "empty", "empty/under", LONG, "/proc/none", "/dev/null", "pipe", "result"):
        yield Try(["sweep", "swept.toml", "--out", out]), ""
    yield Try(["sweep", "swept.toml", "--out", "-"]), "single files only"
    yield Try(["sweep", "swept.toml", "--out", ""]), "expected"
    yield Try(["sweep", "swept.toml", "--out", "store", "--set", "sweep.seed=1"]), "another plan: seed"
    yield Try(["sweep", "store", "--out", "x"]), "--out: expected a scene"
    yield Try(["sweep", "store", "--set", "sweep.seed=1"]), "--set: expected a scene"
    for number in ("-1", "2", "9" * 30, "x", "1.5", "nan"):
        yield Try(["sweep", "store", "--run", number]), "run"
    yield Try(["sweep", "swept.toml", "--run", "0"]), "expected the folder of a sweep"
    yield Try(["sweep", "store", "--run", "0", "--workers", "2"]), "without --workers"
    for workers in ("0", "-1", "9" * 30, "x", "1.5"):
        yield Try(["sweep", "swept.toml", "--out", "x", "--workers", workers]), "workers"
    for address in ("nowhere", "tcp://", "http://127.0.0.1:1", "tcp://127.0.0.1:99999", "\x1b[31m"):
        yield Try(["sweep", "swept.toml", "--out", "x", "--cluster", address]), ""
    for change, said in (
        ("sweep.count=0", "count: expected"),
        ("sweep.count=-1", "count: expected"),
        ("sweep.count=1.5", "count"),
        ("sweep.count=" + "9" * 15, "count: expected a number up to"),
        ("sweep.chunk=0", "chunk: expected"),
        ("sweep.seed=-1", "seed: expected"),
        ('sweep.outputs=["object_pos"]', "Did you mean 'object_pose'?"),
        ('sweep.outputs=["object_pose", "object_pose"]', "every name once"),
        ("sweep.parameters.object_mas=1", "Did you mean 'object_mass'?"),
        ("sweep.parameters.object_mass=nan", "expected a finite number"),
        ("sweep.parameters.object_mass=[]", "object_mass: expected"),
        ("sweep.parameters.object_mass=-1", "object_mass"),
        ("sweep.parameters.object_mass.low=9", "low <= high"),
        ("sweep.parameters.object_mass.high=1e999", "expected a finite number"),
        ("sweep.parameters.object_mass.type='normal'", "unknown field `low`"),
        ("sweep.parameters.object_mass.type='gamma'", "gamma"),
        ("sweep.parameters.gravity=[[0.0], [0.0, 1.0]]", "gravity: expected"),
        ("sweep.parameters.object_inertia='x'", "scale"),
        ("simulation.duration=0.0123", "whole number of steps"),
        ("simulation.on_slip='release'", "on_slip"),
    ):
        yield Try(["sweep", "swept.toml", "--out", "x", "--set", change]), said
    yield Try(["sweep", "swept.toml", "--out", "x"], missing=("pyarrow",)), "holdfast[parquet]"
    yield Try(["sweep", "swept.toml", "--out", "x", "--cluster", "local"], missing=("distributed",)), "holdfast[dask]"


def of_exported_code():
    """Return tries of `export-c` that are refused, and a part of what is said."""
    for out in ("/", ".", "empty", "empty/under", LONG, "/proc/none", "/dev/null", "pipe"):
        yield Try(["export-c", "short.toml", "--function", "project", "--out", out, "--overwrite"]), ""
    yield Try(["export-c", "short.toml", "--out", "-"]), "single files only"
    yield Try(["export-c", "short.toml", "--out", "x", "--function", "forward"]), "forward_dynamics"
    for name in ("1x", "a b", "\u00e9", "x" * 300, "a;b"):
        yield Try(["export-c", "short.toml", "--out", "x", "--function", "project", "--name", name]), "name"
    for option, value in (("--of", "qddd"), ("--by", "p")):
        yield (
            Try(["export-c", "short.toml", "--out", "x", "--function", "forward_dynamics_jacobian", option, value]),
            "",
        )
    for option in ("--target", "--scheme"):
        yield Try(["export-c", "short.toml", "--out", "x", option, "z80"]), "invalid choice"
    yield Try(["export-c", "short.toml", "--out", "x", "--set", "simulation.stp=1"]), "Did you mean 'step'?"


def fine():
    """Return tries that work, however odd their surroundings."""
    bare = {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "COLUMNS": "5", "TERM": "dumb"}
    yield Try(["methods"], environment=bare)
    yield Try(["doctor"], unset=("HOME", "XDG_CACHE_HOME"))
    yield Try(["doctor"], missing=("matplotlib", "viser", "mujoco", "pinocchio"))
    yield Try(["doctor"], environment={"HOLDFAST_CACHE": "empty/under"})
    yield Try(["doctor"], environment={"HOLDFAST_CACHE": LONG})
    yield Try(["solve", "cases.json"], environment=bare | {"COLUMNS": "1"}, unset=("HOME",))
    yield Try(["diagnose", "cases.json"], environment=bare)
    yield Try(["diagnose", "short.toml"])
    yield Try(["diagnose", "short.toml", "--format", "json"])
    nonsense = {"MPLBACKEND": "nonsense", "HOLDFAST_CACHE": "/proc/none"}
    yield Try(["simulate", "short.toml", "--out", "bare"], environment=bare | nonsense, unset=("HOME",))
    yield Try(["simulate", "short.toml", "--out", "again", "--resume", "--no-plots"])  # nothing is there: it begins
    yield Try(["view", "result", "--export", "damaged_mesh.html"])
    yield Try(["export", "result", "--out", "table.csv"])
    yield Try(["sweep", "swept.toml", "--out", "store"])  # nothing is missing there
    yield Try(["sweep", "store", "--json"], environment=bare, unset=("HOME",))
    yield Try(["sweep", "store", "--run", "1"], environment=bare)
    yield Try(["sweep", "swept.toml", "--out", "swept_bare"], environment=bare | nonsense)
    yield Try(["diagnose", "short.toml", "--set", "object.mass=2", "--set", 'name="other"', "--json"])


def half_written(folder):
    """Return the files there that were begun and not ended."""
    return sorted(str(path) for path in folder.rglob("*.part"))


@pytest.mark.long
def test_refused(made):
    """Exit 2, one line, which is an error of ours; nothing on stdout, no file left."""
    table = list(cases())
    before = sorted(made.iterdir())
    wrong = []
    for (one, said), ended in zip(
        table, run_all([one for one, _ in table], made, "viser", "mcap_ros2.writer", "matplotlib.pyplot"), strict=True
    ):
        lines = [line for line in ended.err.splitlines() if not line.startswith(("note: ", "simulating "))]
        proper = (
            ended.code == 2
            and ended.out == ""
            and len(lines) == 1
            and lines[0].startswith("holdfast: error: ")
            and len(lines[0]) < 1000
            and said in lines[0]
            and not any(word in lines[0] for word in ("Traceback", "internal fault", "Errno"))
        )
        if not proper:
            wrong.append(f"{one.arguments} {said!r}: {ended.code} {ended.out[-200:]!r} {ended.err[-600:]}")
    assert not wrong, f"{len(wrong)} of {len(table)}:\n" + "\n".join(wrong)
    left = [path for path in sorted(made.iterdir()) if path not in before and path.suffix not in (".out", ".err")]
    assert left == []
    assert half_written(made) == []


@pytest.mark.slow
def test_odd_surroundings(made):
    """Exit 0 without a home, a locale, a width or a good MPLBACKEND, with a cache that cannot be written."""
    table = list(fine())
    wrong = []
    for one, ended in zip(table, run_all(table, made), strict=True):
        if ended.code or "Traceback" in ended.err or "Warning" in ended.err:
            wrong.append(f"{one.arguments}: {ended.code} {ended.out[-200:]!r} {ended.err[-600:]}")
    assert not wrong, "\n".join(wrong)
    assert half_written(made) == []


SOLVE = f"solve {FILE} --case ball_3arm --format json"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        (f"{SOLVE} >&-", 74, "stdout"),
        (f"{SOLVE} >/dev/full", 74, "stdout: cannot be written: No space left on device"),
        ("--help >/dev/full", 74, "stdout: cannot be written: No space left on device"),
        (f"{SOLVE} 2>&-", 0, ""),
        (f"{SOLVE} 2>/dev/full", 0, ""),
        ("--help <&- >&- 2>&-", 74, ""),
        (f"{SOLVE} | true; exit ${{PIPESTATUS[0]}}", 141, ""),  # gone long before anything is written
        ("solve none.json 2>&-", 2, ""),
        ("solve none.json 2>/dev/full", 2, ""),
        ("solve none.json 2>&1 | true; exit ${PIPESTATUS[0]}", 2, ""),
    ],
)
def test_streams_that_cannot_be_written(command, code, said):
    """74 where stdout cannot be written, 141 where its reader has gone, and nothing else is said.

    A refusal with stderr closed, full or gone keeps its exit code.
    """
    shell = ["bash", "-c", f'"$0" "$@" {command}', *program()]
    done = subprocess.run(shell, capture_output=True, text=True, timeout=60)
    assert (done.returncode, said in done.stderr, len(done.stderr.splitlines())) == (code, True, 1 if said else 0), done
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr


def test_ctrl_c_while_it_starts():
    """One line and 130, also while the commands are imported."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from holdfast.cli import main\n"
        "print('begins', flush=True)\n"
        "sys.exit(main())"
    )
    with subprocess.Popen([sys.executable, "-c", code, "solve", FILE], stdout=-1, stderr=-1, text=True) as running:
        running.stdout.readline()
        time.sleep(0.1)  # into main, whose imports take longer
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=60)
    assert (running.returncode, err) == (130, "holdfast: error: interrupted\n")


@pytest.fixture
def full_disk(tmp_path):
    """A disk of 64 KiB."""
    place = tmp_path / "disk"
    place.mkdir()
    if (
        os.getuid()
        or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", place], capture_output=True).returncode
    ):
        pytest.skip("needs the right to mount a small tmpfs")
    yield place
    subprocess.run(["umount", place], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("problem", ["No space left on device", "Read-only file system"])
def test_a_disk_that_takes_nothing(made, full_disk, problem):
    """A full disk, and one that nobody may write to: the error is said, and nothing half-written stays."""
    if problem == "No space left on device":
        (full_disk / "ballast").write_bytes(b"x" * 40_000)
    else:
        subprocess.run(["mount", "-o", "remount,ro", full_disk], check=True)
    tries = [
        Try(["simulate", str(made / "short.toml"), "--out", str(full_disk / "run")]),
        Try(["export", str(made / "result"), "--out", str(full_disk / "table.csv")]),
        Try(["plot", str(made / "result"), "--out", str(full_disk / "plots")]),
        Try(["view", str(made / "result"), "--export", str(full_disk / "page.html")]),
    ]
    for one, ended in zip(tries, run_all(tries, made), strict=True):
        assert (ended.code, problem in ended.err, "Traceback" in ended.err) == (2, True, False), (one, ended)
    assert half_written(full_disk) == []
