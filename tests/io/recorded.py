"""Runs to save: samples of random numbers, of the shapes that two Pandas give."""

import numpy as np

from holdfast.io.result_folder import ResultWriter, run_meta
from holdfast.simulation.events import Occurrence
from holdfast.simulation.trajectory import EMPTY_FIELDS, RUN_ARRAYS, Trajectory, array_names
from tests.control.two_pandas import two_pandas

SHAPE = {name: (0,) if name in EMPTY_FIELDS else row.shape(two_pandas()[0]) for name, row in RUN_ARRAYS.items()}
KINDS = {"holding": bool, "lowest_joint": int}
SCENE = 'name = "test"\n'
STEP = 0.1
HAPPENED = {
    1: [
        Occurrence(0.05, "attach", "left", "'left' grips, it says", impulses=((0.1, 0.2, 0.3, 4.0, 5.0, 1 / 3),) * 2,
                   base_impulses=((0.0,) * 6,) * 2, energy_change=-0.1),
        Occurrence(0.1, "violation", "left/joint2", "beyond its limit", quantity="rate"),
    ],
    4: [Occurrence(0.4, "recovery", "left/joint2", "within again", "rate", -0.25, 0.3)],
}  # fmt: skip


def samples(count, first=0):
    """Return single samples; the one at place k is the same whatever was asked for."""
    found = []
    for k in range(first, first + count):
        rng = np.random.default_rng(k)
        arrays = {name: (9 * rng.normal(size=SHAPE[name])).astype(KINDS.get(name, float)) for name in array_names()}
        arrays["t"] = np.array(STEP * k)
        found.append(Trajectory(**arrays, occurrences=tuple(HAPPENED.get(k, ()))))
    return found


def meta(**changes):
    """Return what meta.json says of them at first."""
    chain, _ = two_pandas()
    return run_meta(chain, **{"name": "test", "duration": 30.0, "step": STEP} | changes)


def writer(folder, **options):
    """Return a writer to a folder."""
    return ResultWriter(folder, meta(), SCENE, **options)


def filled(folder, *flushes):
    """Return a writer that has flushed so many samples each time, and all of them."""
    w, given = writer(folder), []
    for count in flushes:
        more = samples(count, len(given))
        for one in more:
            w.add(one)
        w.flush()
        given += more
    return w, given


def same_bits(a, b):
    """Assert that two runs are equal bit for bit: every array, its type and shape too, and what happened."""
    assert a.recorded == b.recorded
    for name in a.recorded:
        x, y = np.asarray(getattr(a, name)), np.asarray(getattr(b, name))
        assert (x.dtype, x.shape) == (y.dtype, y.shape), name
        assert x.tobytes() == y.tobytes(), name
    assert a.occurrences == b.occurrences
    assert a.stopped == b.stopped
