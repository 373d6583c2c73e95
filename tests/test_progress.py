"""Progress suits who looks: a cell's bar, a terminal's, a line now and then; and changes no number of what it shows."""

import io
import os
import re
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import progress
from holdfast.compiled import kernels
from holdfast.errors import ModelError
from holdfast.progress import busy, detail, of_time, progress_bar, reporting
from tests.compiler.programs import same_bits
from tests.control.two_pandas import two_pandas
from tests.simulation.rollout.problems import arrays, problem
from tests.simulation.rollout.test_statuses import STEP, gantries, given


class Cell:
    """Stands in for IPython's display: what a cell has shown, in order."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def __call__(self, picture, display_id):
        self.update(picture)
        return self

    def update(self, picture) -> None:
        self.shown.append(picture.data)


@pytest.fixture
def cell(monkeypatch):
    """Return what a notebook's cell shows."""
    display = pytest.importorskip("IPython.display", reason="needs IPython: pip install ipykernel")
    found = Cell()
    monkeypatch.setattr(progress, "in_notebook", lambda: True)
    monkeypatch.setattr(progress, "REFRESH", 0.0)
    monkeypatch.setattr(display, "display", found)
    return found


def test_in_a_cell(cell):
    """One place: a bar without a value, then one that grows, in the end a line that says how long it took."""
    with reporting(True, "simulating <b>", "", of_time(2.0)) as tell:
        for t in (0.5, 1.0, 2.0):
            tell(t)
    parts = [re.search(r'value="([\d.]+)"', shown) for shown in cell.shown]
    assert [None if part is None else float(part[1]) for part in parts] == [None, 0.25, 0.5, 1.0, None]
    assert cell.shown[0] == "<progress></progress> simulating &lt;b&gt;"
    assert "simulating &lt;b&gt;: 1.000 of 2 s, 0 s left" in cell.shown[2]
    assert re.fullmatch(r"simulating &lt;b&gt;: 2\.000 of 2 s, took \d+\.\d s", cell.shown[-1])


def test_in_a_cell_that_fails(cell):
    """The bar does not go on moving."""
    with pytest.raises(ZeroDivisionError), busy(True, "compiling"):
        1 / 0  # noqa: B018
    assert len(cell.shown) == 2 and "<progress" not in cell.shown[-1]


class Terminal(io.StringIO):
    """Stands in for a terminal."""

    def isatty(self) -> bool:
        """Return True, as a terminal does."""
        return True

    @property
    def text(self) -> str:
        """What was written, without what moves the cursor."""
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", self.getvalue())


def on_terminal(patch, patience=0.0):
    """Return the terminal that stderr becomes, and show work there that takes longer than a time [s]."""
    found = Terminal()
    patch.setattr(sys, "stderr", found)
    patch.setenv("COLUMNS", "120")
    patch.setattr(progress, "PATIENCE", patience)
    return found


def test_on_a_terminal(monkeypatch):
    """On stderr, with what is done, how far it is and how much longer it takes."""
    terminal = on_terminal(monkeypatch)
    with progress_bar("simulating [run]") as show:
        show(1.0, "2 of 2 s")
    assert re.search(r"simulating \[run\] \S+ 2 of 2 s \d:\d\d:\d\d", terminal.text)


def long_work(progress=None, inner=None):
    """Do work that is longer than the patience of the tests, with other such work inside."""
    with busy(progress, "outer"):
        time.sleep(0.1)
        with busy(inner, "inner"):
            detail("7 parts")
            time.sleep(0.1)


def test_work_that_takes_long(monkeypatch):
    """It is shown, once, when it has taken a while, with its details; what is over before that is not."""
    terminal = on_terminal(monkeypatch, 1.0)
    long_work()
    assert terminal.text == ""
    monkeypatch.setattr(progress, "PATIENCE", 0.05)
    long_work()
    assert re.search(r"outer \S+ +7 parts", terminal.text) and "inner" not in terminal.text


@pytest.mark.parametrize("hidden", [(False, None), (False, False)])
def test_work_that_is_not_to_be_shown(monkeypatch, hidden):
    """Nor is any work within it, of runs either."""
    terminal = on_terminal(monkeypatch)
    long_work(*hidden)
    with reporting(False, "simulating", "", of_time(1.0)):
        long_work()
    assert terminal.text == ""


def test_work_within_a_run(monkeypatch):
    """The bar of the run is enough."""
    terminal = on_terminal(monkeypatch)
    with progress_bar("simulating"):
        long_work()
    assert "simulating" in terminal.text and "outer" not in terminal.text


def test_long_work_in_a_cell(cell, monkeypatch):
    """A bar without a value, its details, and a line that says how long it took."""
    monkeypatch.setattr(progress, "PATIENCE", 0.05)
    long_work()
    assert cell.shown[0] == "<progress></progress> outer"
    assert "<progress></progress> outer: 7 parts" in cell.shown
    assert re.fullmatch(r"outer: 7 parts, took \d+\.\d s", cell.shown[-1])


def fail_late():
    """Fail in the middle of work that is shown."""
    with busy(None, "compiling"):
        time.sleep(0.1)
        raise ZeroDivisionError


def test_long_work_that_fails(monkeypatch):
    """The bar goes, and the error comes."""
    terminal = on_terminal(monkeypatch)
    with pytest.raises(ZeroDivisionError):
        fail_late()
    assert "compiling" in terminal.text


def test_long_work_that_nobody_sees(capsys, monkeypatch):
    """A log or a pipe gets nothing."""
    monkeypatch.setattr(progress, "PATIENCE", 0.0)
    long_work()
    monkeypatch.setattr(sys, "stderr", None)
    long_work()
    assert capsys.readouterr() == ("", "")


FIRST_CALLS = """
import multiprocessing
import sys

import numpy as np

import holdfast as hf
from holdfast import progress
from tests.simulation.rollout.problems import arrays, problem

progress.PATIENCE = 0.0
chain, state = problem("one")


def shown():
    fast, given = hf.compile(chain), arrays(state)
    fast.forward_dynamics(**given | {"q": np.tile(state.q, (3, 1))}, tau=np.zeros(chain.joint_count))
    fast.kinetic_energy.vjp(**given)


def hidden():
    fast = hf.compile(hf.ClosedChain(chain.arms, chain.held_object, {}), progress=False)
    fast.potential_energy.vjp(state.q, state.object_pose)


if __name__ == "__main__":
    if "child" in sys.argv:
        process = multiprocessing.get_context("spawn").Process(target=shown)
        process.start()
        process.join()
    else:
        hidden()
        shown()
"""


def said_by(folder, *arguments):
    """Return what first calls of machine code say on a terminal, with their cache in a folder."""
    pty = pytest.importorskip("pty", reason="needs Unix")
    (folder / "first_calls.py").write_text(FIRST_CALLS)
    above, below = pty.openpty()
    environment = os.environ | {"HOLDFAST_CACHE": str(folder / "cache"), "COLUMNS": "150"}
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    run = [sys.executable, str(folder / "first_calls.py"), *arguments]
    with subprocess.Popen(run, stderr=below, stdout=subprocess.PIPE, env=environment) as process:
        os.close(below)
        said = b""
        while True:
            try:
                new = os.read(above, 4096)
            except OSError:  # so Linux says that nobody writes any more
                break
            said += new
            if not new:
                break
        out = process.stdout.read() if process.stdout else b""
    os.close(above)
    assert process.returncode == 0 and out == b"", said.decode()
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", said.decode())


@pytest.mark.slow
def test_first_calls_on_a_terminal(tmp_path):
    """They say what is compiled, and how much, unless told not to; the processes of workers say nothing."""
    (tmp_path / "other").mkdir()
    assert said_by(tmp_path / "other", "child") == ""
    text = said_by(tmp_path)
    for name in ("forward_dynamics", "forward_dynamics for batches", "kinetic_energy.vjp"):
        assert re.search(rf"compiling {name} of arm1 \S+ [\d,]+ operations", text), name
    assert "potential" not in text


def test_in_a_log(monkeypatch, capsys):
    """What begins; then a line only after a silence. Work without a beginning says its first and its last."""
    with reporting(True, "simulating run", "2 s in 4 steps", of_time(2.0)) as tell:
        tell(1.0)
        monkeypatch.setattr(progress, "SILENCE", 0.0)
    assert capsys.readouterr().err == "simulating run: 2 s in 4 steps\n"
    monkeypatch.setattr(progress, "SILENCE", 1e3)
    said = []
    with progress_bar("sweeping", say=said.append) as show:
        for part in (0.2, 0.5, 1.0):
            show(part, f"{part}")
    assert said == ["sweeping: 0.2", "sweeping: 1.0"]


def test_nobody_is_told(capsys):
    """Without it nothing is shown; a function is told instead; anything else is refused."""
    for nothing in (None, False):
        with reporting(nothing, "doing", "it", of_time(1.0)) as tell:
            tell(0.5)
    told = []
    with reporting(told.append, "doing", "it", of_time(1.0)) as tell:
        tell(0.5)
    assert told == [0.5] and capsys.readouterr() == ("", "")
    with (
        pytest.raises(ModelError, match="progress: expected True, False or a function, got str"),
        reporting("yes", "doing", "it", of_time(1.0)),
    ):
        pass
    with pytest.raises(ModelError, match="progress: expected True, False or None, got int"), busy(1, "doing"):
        pass


def test_rollouts_that_are_watched(capsys):
    """Parts of a run in which some systems slip: the same bits as in one go, the time told up to the end."""
    rollout, state = gantries()
    rate = given(np.array([400.0, 0.0, 999.0, 20.0]))
    systems = rollout.start(**{name: np.tile(x, (4, 1)) for name, x in arrays(state).items()}, progress=True, **rate)
    told = []
    options = {"every": 200, "record": ("q", "margin", "work"), "least_margin": 0.0}
    first = rollout.run(systems, 0.2, STEP, **options, **rate)
    watched = rollout.run(systems, 0.2, STEP, progress=told.append, **options, **rate)
    assert told == pytest.approx([0.002 * k for k in range(1, 101)])
    assert same_bits(first.stopped, watched.stopped) and same_bits(first.t, watched.t)
    for name in options["record"]:
        assert same_bits(first[name], watched[name]), name
    assert capsys.readouterr().err.startswith("compiling steps of ")


def test_code_made_later(capsys):
    """A chain compiled with progress also shows that of its other functions, at their first call; another does not."""
    chain, state = problem("one")
    for watched in (True, False):
        fast = hf.compile(chain, progress=watched)
        fast.kinetic_energy(state.q, state.qd, state.object_pose, state.object_twist)
        fast.kinetic_energy(state.q, state.qd, state.object_pose, state.object_twist)
        fast.potential_energy.vjp(state.q, state.object_pose)
    said = [line.partition(" of ")[0] for line in capsys.readouterr().err.splitlines()]
    assert said == ["compiling forward_dynamics", "compiling kinetic_energy", "compiling potential_energy.vjp"]


def test_code_for_batches(monkeypatch, capsys, tmp_path):
    """Said once, before the first batch, of forward dynamics, a function and a law; nothing unless asked."""
    monkeypatch.setenv("HOLDFAST_CACHE", str(tmp_path))
    chain, state = two_pandas()
    lighter = replace(chain, held_object=hf.HeldObject.box(0.5, 0.3, 0.2, 0.2))
    q, still, at = np.tile(state.q, (3, 1)), state.qd, (state.object_pose, state.object_twist)
    for asked in (False, True):
        monkeypatch.setattr(kernels, "_made", {})
        fast = hf.compile(lighter, progress=asked)
        law = hf.control.compile_law(hf.control.GravityCompensation(lighter), progress=asked)
        capsys.readouterr()
        for _ in range(2):
            fast.forward_dynamics(q, still, still, *at)
            fast.mass_matrix(q)
            law.torques(0.0, q, still, *at)
        said = [line.partition(" of ")[0] for line in capsys.readouterr().err.splitlines()]
        expected = ["forward_dynamics for batches", "mass_matrix", "mass_matrix for batches"]
        expected.append("control law for batches")
        assert said == ([f"compiling {what}" for what in expected] if asked else [])


@pytest.mark.slow
def test_exported_code(capsys, monkeypatch, tmp_path):
    """What is written is said before it is compiled, as often as it is; nothing unless asked."""
    monkeypatch.setattr(progress, "SILENCE", float("inf"))  # however busy the machine is
    chain, _ = two_pandas()
    law = {"hold": hf.control.GravityCompensation(chain)}
    wanted = {"functions": ["kinetic_energy"], "laws": law, "overwrite": True}
    hf.compile(chain).export(tmp_path / "code", **wanted)
    assert capsys.readouterr().err == ""
    made = hf.compile(chain).export(tmp_path / "code", **wanted, progress=True)
    assert capsys.readouterr().err == "writing code of 2 functions: this may take seconds\n"
    assert list(made.functions) == ["chain_kinetic_energy", "chain_hold"]
    with pytest.raises(ModelError, match="progress: expected True, False or None, got int"):
        hf.compile(chain).export(tmp_path / "code", **wanted, progress=1)
