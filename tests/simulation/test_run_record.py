"""What a run records: chosen arrays, every so many steps, and no more in memory than is allowed."""

from __future__ import annotations

import copy
import pickle
import tracemalloc
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from benchmarks.bench.systems import facing_pandas

import holdfast as hf
from holdfast.control import GravityCompensation
from holdfast.errors import ModelError, StateError
from holdfast.model.grasp import Friction
from holdfast.simulation import run_record
from holdfast.simulation.events import Release
from holdfast.simulation.run_record import STATE_NAMES, STATES
from holdfast.simulation.summary import summarise, summary_of_parts
from holdfast.simulation.trajectory import EMPTY_FIELDS, LOWEST, array_names, part_of
from tests.control.two_pandas import two_pandas
from tests.longer import mostly_slow

STEP = 1e-3


def lift(duration=0.1, **options):
    """Return a run of two arms whose soft fingers hold a box that swings."""
    chain, state = facing_pandas("softfinger", Friction(0.8, torsion_radius=0.02))
    law_at_rest = GravityCompensation(chain, 40.0, 0.1)

    def law(t, now, memory):
        torques, _ = law_at_rest(t, now, None)
        return torques + 0.05 * np.sin(60.0 * t), memory

    given: dict[str, Any] = {"sample_time": STEP} | options
    return hf.simulate(chain, state, law, duration, STEP, **given)


@pytest.mark.slow
def test_every_sample_is_one_of_all():
    """Arrays of a run with fewer samples are those of the whole run, and lowest margins are those since the last."""
    whole, some = lift(), lift(every=7)
    at = [int(np.flatnonzero(whole.t == t)[0]) for t in some.t]
    grid = np.round(some.t / (7 * STEP)) * 7 * STEP
    assert at[0] == 0 and at[-1] == len(whole) - 1 and len(at) < 40
    assert np.abs(some.t - grid)[:-1].max() < 1e-12
    for name in array_names():
        if name not in LOWEST and not any(name in others for others in LOWEST.values()):
            np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[at], err_msg=name)
    for name, begin, end in ((name, *pair) for name in LOWEST for pair in pairwise(at)):
        margins = getattr(whole, name)[begin + 1 : end + 1]
        np.testing.assert_array_equal(getattr(some, name)[at.index(end)], margins.min(axis=0), err_msg=name)
        for other in LOWEST[name]:
            best = np.take_along_axis(getattr(whole, other)[begin + 1 : end + 1], margins.argmin(axis=0)[None], axis=0)
            np.testing.assert_array_equal(getattr(some, other)[at.index(end)], best[0], err_msg=other)
    assert some.summary().lowest_margin == whole.summary().lowest_margin
    assert some.summary().energy_imbalance <= whole.summary().energy_imbalance
    assert some.summary().momentum_imbalance is None
    with pytest.raises(StateError, match="expected a sample at every step, got one every 7"):
        _ = some.momentum_imbalance


@pytest.mark.slow
def test_both_sides_of_an_event():
    """What happens between two samples is recorded with the chain before and after it."""
    chain, state = two_pandas("rigid", "rigid")
    law = GravityCompensation(chain)
    some = hf.simulate(chain, state, law, 0.1, STEP, events=[Release(0.0333, "left")], every=50)
    k = int(np.flatnonzero(some.t == 0.0333)[0])
    assert some.holding[k - 1].all() and not some.holding[k, chain.names.index("left")]
    assert some.t[k] - some.t[k - 1] < 1e-12 and [one.kind for one in some.occurrences] == ["release"]
    assert len(some) == 5  # start, both sides, 0.05 and the end


@pytest.mark.parametrize(
    "record", mostly_slow([STATES, ["q", "wrist_wrench"], ["lowest_margin_time"], "kinetic"], [STATES])
)
def test_chosen_arrays(record):
    """They have the same bits as in a run with everything; the others raise an error that names them."""
    whole, some = lift(0.02), lift(0.02, record=record)
    listed = STATE_NAMES if record == STATES else [record] if isinstance(record, str) else record
    lowest = ["lowest_margin"] if "lowest_margin_time" in listed else []
    assert set(some.recorded) == {"t", *listed, *lowest, *EMPTY_FIELDS}
    for name in array_names():
        found = getattr(some, name)
        if name in some.recorded:
            np.testing.assert_array_equal(found, getattr(whole, name))
            continue
        for use in (np.asarray, np.abs, np.max, len, float, lambda x: x[0], lambda x: x.shape, lambda x: x + 1.0):
            with pytest.raises(StateError, match=f"'{name}' was not recorded"):
                use(found)
    for copied in (pickle.loads(pickle.dumps(some)), copy.deepcopy(some), replace(some, stopped="x")):
        assert copied.recorded == some.recorded
    with pytest.raises(StateError, match="was not recorded"):
        some.summary()


@pytest.mark.slow
def test_states_are_enough_to_interpolate():
    """`state_at` of a run of states, every five steps, is that of all steps to the order of the interpolation."""
    chain, state = two_pandas("rigid", "rigid")
    given = (chain, state, GravityCompensation(chain, 0.0, 0.5), 0.1, STEP)
    whole, some = hf.simulate(*given), hf.simulate(*given, record=STATES, every=5)
    for t in (0.0123, 0.0501, 0.0999):
        np.testing.assert_allclose(some.state_at(t).q, whole.state_at(t).q, atol=1e-9)


def test_wrong_choices():
    """They are refused before the first step, with what there is."""
    for record, words in (
        ("state", "Did you mean 'states'"),
        (["q", "wrist_wrenches"], "Did you mean 'wrist_wrench'"),
        ([], "expected 'everything', 'states' or names"),
        (3, "got 3"),
        ([3], "no array 3"),
    ):
        with pytest.raises(ModelError, match=words):
            lift(record=record)
    for every in (0, 2.0, True, "2"):
        with pytest.raises(ModelError, match="every: expected a number of steps"):
            lift(every=every)


def test_too_many_samples():
    """A run that does not fit into memory says what would."""
    with pytest.raises(ModelError, match=r"at most 1000000 samples in memory, got 2e\+06; try every=3, or folder"):
        lift(2000.001, sample_time=None)


@pytest.mark.parametrize(
    "options", [*mostly_slow([{}, {"every": 3}], []), {"record": ["q", "lowest_margin"], "every": 2}]
)
def test_resumed(options):
    """From the checkpoint of any recorded sample the run goes on to the bit."""
    saved, seen = [], []
    whole = lift(0.02, on_checkpoint=saved.append, on_sample=seen.append, **options)
    assert len(saved) == len(seen)
    for k in (0, 1, len(saved) // 2, len(saved) - 2):
        later = lift(0.02, start=saved[k], **options)
        begin = int(np.flatnonzero(whole.t == saved[k].now.t)[0]) + 1
        for name in whole.recorded:
            np.testing.assert_array_equal(getattr(later, name), getattr(whole, name)[begin:], err_msg=name)


@pytest.mark.parametrize("options", mostly_slow([{}, {"every": 4}, {"record": STATES}], [{"every": 4}]))
def test_folder_and_memory(tmp_path, monkeypatch, options):
    """A run whose samples are only on disk has the same arrays, summary and files as one in memory."""
    inside = lift(0.1, folder=tmp_path / "inside", **options)
    monkeypatch.setattr(run_record, "MOST_KEPT", 10_000)
    outside = lift(0.1, folder=tmp_path / "outside", **options)
    assert "q" not in vars(outside) and "q" in vars(inside)
    assert len(outside) == len(inside) and outside.recorded == inside.recorded and outside.every == inside.every
    loaded = hf.load_result(tmp_path / "outside")
    for name in inside.recorded:
        for other in (outside, loaded.trajectory):
            np.testing.assert_array_equal(getattr(other, name), getattr(inside, name), err_msg=name)
    assert loaded.trajectory.every == inside.every and loaded.complete and not loaded.note
    summaries = [tmp_path / name / "summary.json" for name in ("inside", "outside")]
    if options.get("record"):
        assert not any(path.exists() for path in summaries)
    else:
        assert summaries[0].read_bytes() == summaries[1].read_bytes()
        assert outside.summary() == inside.summary()
    assert outside.save(tmp_path / "copy").exists() and hf.load_result(tmp_path / "copy").complete


@pytest.mark.slow
def test_memory_is_bounded(tmp_path, monkeypatch):
    """Three times as long a run with a folder takes no more memory."""
    monkeypatch.setattr(run_record, "MOST_KEPT", 2**20)
    peaks = []
    lift(0.1)
    for duration in (1.0, 3.0):
        tracemalloc.start()
        lift(duration, folder=tmp_path / f"{duration}")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.15 * peaks[0] + 2**20


@pytest.fixture(scope="module")
def eventful():
    """Return two chains and a run of each: one with a jump at every step, one whose grasp opens, so that it falls."""
    sampled = lift(0.05)
    chain, state = two_pandas("rigid", "rigid")
    law = GravityCompensation(chain, 0.0, 0.5)
    falls = hf.simulate(chain, state, law, 0.05, STEP, events=[Release(0.0123, "left")], breakpoints=[0.02, 0.0215])
    return [(run.require_setting().chain, run) for run in (sampled, falls)]


@pytest.mark.slow
@pytest.mark.parametrize("cut", [1, 2, 3, 5, 17])
def test_summary_of_parts(cut, eventful):
    """The summary of a run in parts is that of the whole, to the bit, also across jumps."""
    for chain, run in eventful:
        parts = [part_of(run, slice(k, k + cut)) for k in range(0, len(run), cut)]
        found = summary_of_parts(chain, parts, run.stopped, run.occurrences)
        assert found == summarise(chain, run) and found.momentum_imbalance != (0.0, 0.0)
