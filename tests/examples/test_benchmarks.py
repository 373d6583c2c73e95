"""The public benchmarks, each script as it stands: its figures are the published ones, and exact ones where known."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import holdfast as hf
from tests.examples.test_examples import EXAMPLES, script
from tests.systems.four_bar import held_four_bar, held_state
from tests.systems.n_four_bar import passing_times

FOLDER = EXAMPLES / "benchmarks"


def test_all_are_listed():
    """Four scripts, none longer than 120 lines, each in the table of the folder above."""
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    assert names == ["andrews", "bricard", "four_bar", "n_four_bar"]
    table = (FOLDER.parent / "README.md").read_text()
    for name in names:
        assert f"](benchmarks/{name}.py)" in table
        assert len((FOLDER / f"{name}.py").read_text().splitlines()) <= 120, name


@pytest.mark.slow
def test_four_bar(capsys):
    """The published angle and eigenvalues to 1e-9, and those of the one equation of the linkage in 30 digits."""
    four_bar = script(FOLDER / "four_bar.py")
    found = four_bar.main()
    assert capsys.readouterr().out.count("published") == 3
    assert found["angle"] == pytest.approx(four_bar.ANGLE, abs=1e-10)
    for name, published in (("spring", four_bar.SPRING), ("damper", four_bar.DAMPER)):
        assert abs(found[name] - published) < 1e-9
    linkage = four_bar.four_bar()
    assert linkage.arms["rods"].loops and not linkage.objects and linkage.held_object is None
    for angle, rate, damping in ((1.2, 0.7, 0.0), (2.1, -1.5, 1.0)):  # as with the rod B-C held by two cranks
        held = hf.forward_dynamics(held_four_bar(damping), held_state(angle, rate), np.zeros(2)).qdd[0]
        assert four_bar.acceleration(linkage, angle, rate, damping) == pytest.approx(held, rel=1e-12)

    mp = mpmath.mp.clone()
    mp.dps = 30

    def length(x):
        return 2 * mp.cos(x / 2)

    def energy(x):
        return 2 * mp.mpf("9.81") * mp.sin(x) + mp.mpf(25) / 2 * (length(x) - mp.sqrt(2)) ** 2

    angle, inertia = mp.findroot(lambda x: mp.diff(energy, x), 2.234), mp.mpf(5) / 3
    stiffness, resistance = mp.diff(energy, angle, 2) / inertia, mp.diff(length, angle) ** 2 / inertia
    assert found["angle"] == pytest.approx(float(angle), abs=1e-13)
    assert found["spring"].imag == pytest.approx(float(mp.sqrt(stiffness)), abs=1e-11)
    assert found["damper"].real == pytest.approx(float(-resistance / 2), abs=1e-11)
    assert found["damper"].imag == pytest.approx(float(mp.sqrt(stiffness - resistance**2 / 4)), abs=1e-11)


@pytest.mark.slow
def test_andrews(capsys):
    """The published angles within 1e-9 of the largest, and the published accelerations at the start to 1e-13."""
    andrews = script(FOLDER / "andrews.py")
    chain, state = andrews.andrews()
    tau, _ = andrews.motor(0.0, state, None)
    start = hf.forward_dynamics(chain, state, tau)
    assert start.qdd[0] == pytest.approx(14222.4439199541138705911625887, rel=1e-13)
    assert start.qdd[1] == pytest.approx(-10666.8329399655854029433719415, rel=1e-13)
    assert max(np.abs(start.qdd[2:]).max(), np.abs(start.object_acceleration).max()) < 1e-9
    found = andrews.main()
    assert capsys.readouterr().out.count("published") == 7
    off = [abs(found[name] - end) for name, end in zip(andrews.NAMES, andrews.END, strict=True)]
    assert max(off) < 1e-9 * np.abs(andrews.END).max()


@pytest.mark.slow
def test_bricard(capsys):
    """The printed sum, of a scheme of second order, to 5e-6; a freedom and a redundant row; energy is kept."""
    found = script(FOLDER / "bricard.py").main()
    assert "freedoms 1, redundant rows 1" in capsys.readouterr().out
    assert found["mobility"] == found["redundant"] == 1
    assert found["sum"] == pytest.approx(4.172189649307425, abs=5e-6)
    assert found["energy_error"] < 1e-13 * found["kinetic"]
    assert found["gap"] < 1e-14


@pytest.mark.slow
def test_n_four_bar_folds(capsys):
    """Two flat configurations, where two freedoms open, are passed when the parallelogram's one equation says so."""
    run = script(FOLDER / "n_four_bar.py").main(2.0)
    assert "2 times flat" in capsys.readouterr().out
    assert run.stopped is None
    assert [(one.rank, one.generic_rank) for one in run.occurrences] == [(10, 12)] * 2
    assert np.abs(np.array([one.t for one in run.occurrences]) - passing_times(3, 2)).max() < 1e-9
    assert np.ptp(run.kinetic + run.potential) < 1e-10


@pytest.mark.long
def test_n_four_bar():
    """After ten seconds within 5e-8 m of what the published places tend to."""
    n_four_bar = script(FOLDER / "n_four_bar.py")
    run = n_four_bar.main()
    assert run.stopped is None and len(run.occurrences) == 10
    assert np.abs([np.cos(run.q[-1, 0]), np.sin(run.q[-1, 0])] - n_four_bar.limit()).max() < 5e-8
