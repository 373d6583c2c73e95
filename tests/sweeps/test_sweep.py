"""A sweep gives the bytes of its plan, however it is computed, and any run again."""

import json
import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.sweeps import Uniform, store
from holdfast.sweeps.workers import computed_by_processes
from tests.compiler.started_threads import started_threads
from tests.control.two_pandas import two_pandas
from tests.sweeps.problems import data, law, small_sweep

pytest.importorskip("pyarrow", reason="needs pyarrow: pip install 'holdfast[parquet]'")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Return the sweep computed in this process at one go."""
    return small_sweep(tmp_path_factory.mktemp("sweep") / "store")


def test_as_rollouts(undisturbed):
    """A run is that of a rollout started with the parameters that stand in its row."""
    chain, state = two_pandas()
    rollout = hf.compile_rollout(chain, law())
    number, names = 17, undisturbed.columns
    own = {name: undisturbed.column(name)[number] for name in names if name.startswith("drawn")}
    push = [own[f"drawn object_wrench[{k}]"] for k in range(6)]
    frames = [[own[f"drawn grasp_pose[{g},{k}]"] for k in range(7)] for g in range(2)]
    given = {"object_mass": own["drawn object_mass"], "object_inertia": "scale", "stiffness": 200.0}
    systems = rollout.start(
        state.q[None], state.qd, state.object_pose, state.object_twist, object_wrench=push, grasp_pose=frames, **given
    )
    rollout.step(systems, 1e-3, steps=4)
    kept = [name for name in names if name.startswith("object_pose")]
    assert [undisturbed.column(name)[number] for name in kept] == systems.object_pose[0].tolist()
    assert undisturbed.column("run").tolist() == list(range(33))
    assert undisturbed.status_counts == {"RUNNING": 33}


def test_a_run_again(undisturbed):
    """Replayed, a run ends at the bits that were kept, and is a run of `simulate` in all else."""
    found = undisturbed.run(22)
    assert len(found) == 5
    kept = [title for title in undisturbed.columns if title.startswith("object_twist")]
    assert [undisturbed.column(title)[22] for title in kept] == found.object_twist[-1].tolist()
    assert found.require_setting().chain.held_object.mass == undisturbed.column("drawn object_mass")[22]
    with pytest.raises(hf.errors.StateError, match="from 0 to 32"):
        undisturbed.run(33)


def test_whatever_happened(undisturbed, tmp_path):
    """Files that are missing, torn or of another plan are computed again; the others stay untouched."""
    store = tmp_path / "store"
    small_sweep(store)
    expected = data(undisturbed.folder)
    assert data(store) == expected
    (store / "runs_000001.parquet").unlink()
    (store / "runs_000002.parquet").write_bytes(expected["runs_000002.parquet"][:-9])
    (store / "runs_000003.parquet").write_bytes(
        data(small_sweep(tmp_path / "other", seed=1).folder)["runs_000003.parquet"]
    )
    (store / "runs_000004.parquet.part").write_bytes(b"half")
    kept = (store / "runs_000000.parquet").stat().st_mtime_ns
    seen = []
    small_sweep(store, progress=seen.append)
    assert data(store) == expected
    assert [p.done for p in seen] == [23, 28, 33]
    assert kept == (store / "runs_000000.parquet").stat().st_mtime_ns
    assert str(seen[-1]).startswith("33 of 33 runs, ")


def test_chunks_in_wrong_places(undisturbed, tmp_path):
    """Chunks that were exchanged, or are of another plan, are named when they are read, and computed again."""
    store = small_sweep(tmp_path / "store").folder
    names = ["runs_000001.parquet", "runs_000002.parquet"]
    for name, other in zip(names, reversed(names), strict=True):
        (store / name).write_bytes(data(undisturbed.folder)[other])
    found = small_sweep(store)
    assert data(store) == data(undisturbed.folder)
    (store / names[0]).write_bytes(data(small_sweep(tmp_path / "other", seed=1).folder)[names[0]])
    with pytest.raises(
        hf.errors.ResultError, match=r"runs_000001\.parquet is damaged, or another file.*call `sweep` again"
    ):
        found.column("run")
    assert small_sweep(store).column("run").tolist() == list(range(33))


def interrupted_sweep(store, done):
    """Compute a sweep until so many runs are done, when the caller's own function raises."""

    def stop(progress):
        if progress.done >= done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        small_sweep(store, progress=stop)


def test_what_a_crash_kept_out_of_the_manifest(undisturbed, tmp_path, monkeypatch):
    """Chunks since the last commit are known by the log, unless a line or the file is damaged."""
    monkeypatch.setattr(store.Store, "close", lambda self: self._lock.close())
    interrupted_sweep(tmp_path, 20)
    assert len(json.loads((tmp_path / "sweep.json").read_text())["files"]) == 0
    lines = (tmp_path / "log.jsonl").read_bytes().splitlines()
    lines[1] = lines[1].replace(b'"sha256": "', b'"sha256": "0')
    lines.insert(3, b'{"chunk": "x"\xff')
    (tmp_path / "log.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    seen = []
    small_sweep(tmp_path, progress=seen.append)
    assert len(seen) == 7 - 3  # the second of four is computed again
    assert data(tmp_path) == data(undisturbed.folder)


def test_by_any_executor(undisturbed, tmp_path):
    """Three threads give the same bytes."""
    with ThreadPoolExecutor(3) as threads:
        small_sweep(tmp_path, workers=threads, ahead=4)
    assert data(tmp_path) == data(undisturbed.folder)


def test_threads_of_chunks(tmp_path, monkeypatch):
    """A process alone divides a chunk among threads, by the same bytes; executors are told to run several chunks."""
    started = started_threads(monkeypatch, processors=3, least_work=1)
    with ThreadPoolExecutor(1) as pool:
        small_sweep(tmp_path / "executor", workers=pool, chunk=33)
        worker = pool.submit(threading.get_ident).result()
    assert started and worker not in started  # the plan's check starts some, in this thread
    before = len(started)
    small_sweep(tmp_path / "alone", chunk=33)
    assert len(started) > 2 * before
    assert data(tmp_path / "alone") == data(tmp_path / "executor")


def test_an_error_midway(undisturbed, tmp_path):
    """What was finished before the caller's own function raised is kept, and the folder is free again."""
    interrupted_sweep(tmp_path, 10)
    assert len(data(tmp_path)) == 2
    small_sweep(tmp_path)
    assert data(tmp_path) == data(undisturbed.folder)


def test_summaries(undisturbed, tmp_path):
    """Quantiles and worst runs are those of the sorted column; the figure is written."""
    mass = undisturbed.column("drawn object_mass")
    assert undisturbed.quantiles("drawn object_mass", [0.0, 0.5, 1.0]).tolist() == [*np.sort(mass)[[0, 16, 32]]]
    order = np.argsort(mass)
    assert [run for run, _ in undisturbed.worst("drawn object_mass", 3)] == order[:3].tolist()
    assert undisturbed.worst("drawn object_mass", 2, largest=True) == [(k, mass[k]) for k in order[:-3:-1]]
    assert 2.0 <= mass.min() < mass.max() <= 4.0
    undisturbed.plot("drawn object_mass", tmp_path / "mass.png")
    assert (tmp_path / "mass.png").read_bytes()[:4] == b"\x89PNG"


def test_failures_by_status(tmp_path):
    """A run whose grasps are far apart fails alone, and says so in its row."""
    _, state = two_pandas()
    q = np.tile(state.q, (6, 1))
    q[4, 0] += 1.0
    found = small_sweep(tmp_path, parameters={"q": q, "stiffness": 1.0}, count=6, chunk=6, duration=1e-3)
    assert found.status_counts == {"RUNNING": 5, "OPEN": 1}
    assert found.column("run", status="OPEN").tolist() == [4]
    assert found.column("stopped [s]")[4] == 0.0
    with pytest.raises(hf.errors.StateError, match="ended as SLIPPED, got none"):
        found.quantiles("object_pose z [m]", status="SLIPPED")


@pytest.mark.parametrize(
    ("changed", "error", "said"),
    [
        ({"count": 0}, hf.errors.StateError, "count"),
        ({"chunk": 2.5}, hf.errors.StateError, "chunk"),
        ({"seed": -1}, hf.errors.StateError, "seed"),
        ({"workers": 0}, hf.errors.StateError, "workers"),
        ({"step": -1e-3}, hf.errors.StateError, "step"),
        ({"duration": 1.5e-3}, hf.errors.StateError, "whole number of steps"),
        ({"outputs": ["object_pos"]}, hf.errors.StateError, "Did you mean 'object_pose'"),
        ({"outputs": ["q", "q"]}, hf.errors.StateError, "once"),
        ({"parameters": {}}, hf.errors.StateError, "'stiffness' is missing"),
        ({"parameters": {"stiffness": 1.0, "object_mas": 1.0}}, hf.errors.StateError, "Did you mean 'object_mass'"),
        ({"parameters": {"stiffness": np.ones(32)}}, hf.errors.StateError, "stiffness"),
        ({"parameters": {"stiffness": Uniform(np.inf, 1.0)}}, hf.errors.StateError, "stiffness"),
        ({"state": None}, hf.errors.StateError, "state"),
    ],
)
def test_refusals(changed, error, said, tmp_path):
    """What does not fit is refused by name before anything is written."""
    with pytest.raises(error, match=said):
        small_sweep(tmp_path, **changed)
    assert not data(tmp_path)


def test_stores_of_others(undisturbed, tmp_path):
    """A folder of another plan, of something else, or one that is written now, is refused."""
    with pytest.raises(hf.errors.ResultError, match="seed differ"):
        small_sweep(undisturbed.folder, seed=1)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(hf.errors.ResultError, match="other files"):
        small_sweep(tmp_path)
    with pytest.raises(hf.errors.ResultError, match="another process writes"):
        small_sweep(tmp_path / "new", progress=lambda _: small_sweep(tmp_path / "new"))
    (tmp_path / "new" / "sweep.json").write_text(json.dumps({"format": "else"}))
    with pytest.raises(hf.errors.ResultError, match=r"sweep\.json: expected .* got 'else' .*; call `sweep` again"):
        small_sweep(tmp_path / "new", seed=1)
    small_sweep(tmp_path / "new")
    for path in (tmp_path / "new").glob("runs_*"):
        path.unlink()
    (tmp_path / "new" / "sweep.json").write_text(json.dumps({"format": "else"}))
    with pytest.raises(hf.errors.ResultError, match=r"got 'else' .*; is this a sweep folder"):
        small_sweep(tmp_path / "new")


@pytest.mark.slow
def test_processes_that_die_and_die(tmp_path):
    """A chunk that ends its process every time is given up, and the sweep says so."""
    with pytest.raises(hf.errors.ResultError, match="died 3 times"):
        list(computed_by_processes(iter([Deadly()]), 1, most_deaths=2))


@pytest.mark.long
@pytest.mark.parametrize("workers", [3, 7])
def test_by_processes(workers, undisturbed, tmp_path):
    """Three or seven processes give the bytes of one."""
    small_sweep(tmp_path, workers=workers)
    assert data(tmp_path) == data(undisturbed.folder)


class Deadly:
    """What ends the process that takes it."""

    def __reduce__(self):
        return os._exit, (1,)


LARGE = {"count": 20000, "chunk": 100, "duration": 0.2}  # seconds of work: nobody is done before being killed


@pytest.mark.long
def test_by_dask(tmp_path):
    """A cluster of Dask is an executor like any other: one of its workers dies, and the bytes are the same."""
    distributed = pytest.importorskip("distributed", reason="needs distributed: pip install 'holdfast[dask]'")
    several = {"count": 600, "chunk": 20, "duration": 0.02}
    expected = data(small_sweep(tmp_path / "undisturbed", **several).folder)
    local = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "local_directory": str(tmp_path)}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        killed = []

        def kill_one(progress):
            if not killed:
                killed.append(cluster.workers[0].pid)
                os.kill(killed[0], signal.SIGKILL)

        small_sweep(tmp_path / "store", workers=client.get_executor(), ahead=6, progress=kill_one, **several)
    assert killed
    assert data(tmp_path / "store") == expected


def _disturbed(store):
    small_sweep(store, workers=2, **LARGE)


def _working(pid):
    """Return the children that compute: the resource tracker of multiprocessing does not."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            parent = (place / "stat").read_text().rpartition(")")[2].split()[1]
            if int(parent) == pid and "spawn_main" in (place / "cmdline").read_text():
                found.append(int(place.name))
        except OSError:  # it has ended meanwhile
            continue
    return found


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.skipif(not os.path.exists("/proc/self/cmdline"), reason="needs Linux's /proc; none can be installed")
def test_killed(tmp_path):
    """Workers killed twenty times, the process that plans three times: every byte as undisturbed, none left over."""
    expected = data(small_sweep(tmp_path / "undisturbed", **LARGE).folder)
    random, context = np.random.default_rng(0), multiprocessing.get_context("spawn")
    store, killed, left = tmp_path / "store", [], []
    for life in range(4):
        process = context.Process(target=_disturbed, args=(store,))
        process.start()
        before, until = len(data(store)), (7, 7, 6, 0)[life]
        while until and process.is_alive():
            time.sleep(random.uniform(0.2, 0.6))
            if len(data(store)) > before and (workers := _working(process.pid)):
                os.kill(int(random.choice(workers)), signal.SIGKILL)
                killed.append(life)
                until, before = until - 1, len(data(store))
        if life < 3:
            left += _working(process.pid)
            process.kill()
        process.join()
        assert process.exitcode == (-signal.SIGKILL if life < 3 else 0)
    assert len(killed) == 20
    assert left
    assert data(store) == expected
    time.sleep(1.0)
    assert not [pid for pid in left if os.path.exists(f"/proc/{pid}")]


@pytest.mark.slow
def test_sampled_laws(tmp_path):
    """The noise of a run depends on its number alone: not on chunks, and the same in `run` and in `simulate`."""
    chain, state = two_pandas()
    noise = {"noise": {"q": 1e-5, "tau": 0.1}, "seed": 3, "resolution": {"q": 1e-5}}
    sampled = hf.control.sampled(law(), chain, sample_time=2e-3, delay=1e-3, **noise)
    plan = {"state": state, "parameters": {"stiffness": 200.0}, "count": 7, "duration": 8e-3, "step": 1e-3}
    one, other = (
        hf.sweep(chain, sampled, store=tmp_path / f"{chunk}", outputs=("q", "tau"), chunk=chunk, **plan)
        for chunk in (3, 5)
    )
    for title in one.columns:
        assert one.column(title).tolist() == other.column(title).tolist()
    positions = np.array([one.column(title) for title in one.columns if title.startswith("q ")])
    assert len(np.unique(positions[0])) == 7
    assert one.run(4).q[-1].tolist() == positions[:, 4].tolist()
    own = hf.control.noise_stream(sampled, 4)
    run = hf.simulate(chain, state, own, 8e-3, 1e-3, parameters={"stiffness": 200.0})
    assert np.abs(run.q[-1] - positions[:, 4]).max() <= 1e-11
    with pytest.raises(hf.errors.StateError, match=r"expected one that divides the sample time 0\.002 s"):
        hf.sweep(chain, sampled, store=tmp_path / "odd", **(plan | {"step": 8e-3}))
