"""Pinocchio gets the same systems and, however they are posed to it, gives our answers."""

import functools

import numpy as np
import pytest
from benchmarks.bench.entries import ACCURATE, relative_error
from benchmarks.bench.measure import reference
from benchmarks.bench.systems import make_system

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")

from benchmarks.bench import pinocchio_peer as entries
from benchmarks.bench.pinocchio_peer import PinocchioModel

SIZES = ((2, 7), (4, 7), (2, 24))


@functools.cache
def solved(arms, joints):
    """Return a system and the answers of our equations on NumPy."""
    system = make_system(arms, joints, 4)
    return system, reference(system)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("form", ["free", "tree"])
def test_constraint_dynamics(size, form):
    """Accelerations and grasp wrenches are ours; the tree form lacks those of the holding arm, and says so."""
    system, truth = solved(*size)
    entry = entries.cholesky(system, form, None)
    got = entry.answers()
    assert relative_error(got.qdd, truth.qdd) <= ACCURATE
    assert relative_error(got.wrenches, truth.wrenches) <= ACCURATE
    missing = np.isnan(got.wrenches).any(axis=(0, 2))
    assert missing.tolist() == [form == "tree", *[False] * (size[0] - 1)]
    assert ("without the wrench" in entry.note) == (form == "tree")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["free", "tree"])
def test_lcaba_is_tuned(form):
    """The chosen setting is accurate, stays so after thousands of calls, and is named."""
    system, truth = solved(2, 7)
    entry = entries.lcaba(system, form, truth)
    assert "mu = " in entry.note
    assert "iterations" in entry.note
    for _ in range(500):
        entry.sweep()
    assert relative_error(entry.answers().qdd, truth.qdd) <= ACCURATE


def test_a_bad_setting_spoils_the_data():
    """Why every setting is tried on fresh data: the errors of one stay for the next."""
    import pinocchio as pin

    system, truth = solved(2, 7)
    posed = PinocchioModel(system, "tree")
    data, weld_data = posed.model.createData(), posed.weld_data()
    pin.computeJointMinimalOrdering(posed.model, data, posed.welds)

    def error(mu, iterations):
        settings = pin.ProximalSettings(1e-14, 1e-14, mu, iterations)
        solve = functools.partial(_lcaba, pin, posed, data, weld_data, settings)
        return relative_error([posed.answers(solve) for _ in range(20)][-1].qdd, truth.qdd)

    assert error(1e-5, 4) <= ACCURATE
    assert error(1e-2, 1) > 1e-3
    assert error(1e-5, 4) > 1e-3


def _lcaba(pin, posed, data, weld_data, settings, q, v, tau):
    return pin.lcaba(posed.model, data, q, v, tau, posed.welds, weld_data, settings)


def test_fewest_iterations():
    """The fewest that are accurate, the best mu of these; one that drifts is passed over; else the most accurate."""

    def error(mu, iterations, seconds):
        drift = 1e3 if (mu, iterations, seconds) == (1e-5, 3, entries.PROBATION) else 1.0
        return drift * {2: 1e-4, 3: 5e-10, 4: 1e-12}[iterations] * (1.0 if mu == 1e-5 else 1.5)

    assert entries.fewest_iterations(error, (1e-5, 1e-6), (2, 3, 4)) == (1e-6, 3)
    assert entries.fewest_iterations(error, (1e-5,), (2, 3, 4)) == (1e-5, 4)
    assert entries.fewest_iterations(lambda mu, n, s: mu if n > 2 else float("nan"), (0.1, 0.2), (2, 3)) == (0.1, 3)


def test_floor_is_no_competitor():
    """The form without grasps is marked, and is not close to the answers."""
    system, truth = solved(2, 7)
    entry = entries.aba(system, None)
    assert entry.floor
    assert relative_error(entry.answers().qdd, truth.qdd) > 0.1


@pytest.mark.slow
def test_one_thread():
    """Pinocchio's threads are one after the benchmark has set them, even if the caller had not."""
    import os
    import subprocess
    import sys

    code = (
        "from benchmarks.bench import run, clock\n"
        "run.run(run.Plan('none', ((2, 7),), (1,), (), (), 1, clock.Effort(1e-4, 1)))\n"
        "import pinocchio; print(pinocchio.omp_get_max_threads())"
    )
    environment = {k: v for k, v in os.environ.items() if k != "OMP_NUM_THREADS"}
    out = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["1"]
