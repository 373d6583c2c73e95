"""A run that was left anywhere goes on to the same bits, or is refused with the reason."""

import os

import numpy as np
import pytest

from holdfast.errors import ResultError
from holdfast.io import result_folder
from holdfast.io.result_folder import ResultWriter
from holdfast.io.result_reader import load_result
from holdfast.simulation.checkpoint import Checkpoint
from tests.control.two_pandas import two_pandas
from tests.io import remembering
from tests.io.recorded import SCENE, filled, meta, same_bits, samples, writer
from tests.io.remembering import Died, dies_at, run
from tests.io.signing import resigned
from tests.longer import mostly_slow

SAMPLES = 13


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the run that nobody interrupts."""
    return run(tmp_path_factory.mktemp("whole") / "run")


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """Flush the first sample, and then every third; never by the clock."""
    monkeypatch.setattr(result_folder, "CHUNK", 3)
    monkeypatch.setattr(result_folder, "LONGEST_WAIT", np.inf)


@pytest.mark.parametrize("sample", mostly_slow([1, 9], (9,)))
def test_goes_on_to_the_same_bits(sample, whole, tmp_path):
    """Whichever sample was the last: the rest comes from the checkpoint of the last flush, memory and all."""
    with pytest.raises(Died):
        run(tmp_path / "run", marked=dies_at(sample))
    flushed = 1 + (sample - 1) // 3 * 3
    assert load_result(tmp_path / "run").samples == flushed
    rest = run(tmp_path / "run", resume=True)
    assert len(rest) == SAMPLES - flushed
    found = load_result(tmp_path / "run")
    assert found.complete
    same_bits(found.trajectory, whole)
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "meta.json", "scene.toml", *(f"chunk_{k:04d}.npz" for k in range(len(found.chunks)))}  # fmt: skip


@pytest.mark.slow
def test_interrupted_between_a_sample_and_its_checkpoint(whole, tmp_path):
    """Ctrl-C keeps that sample; going on makes it again."""

    def interrupt(n):
        if n == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run", added=interrupt)
    found = load_result(tmp_path / "run")
    assert found.note.endswith(": interrupted")
    assert found.chunks == (1, 3, 2)
    # a writer that dies while it makes the folder ready leaves one that can be read and made ready again
    for call, at in (("replace", 0), ("replace", 1), ("unlink", 0)):
        with pytest.MonkeyPatch.context() as patched:
            kill_call(patched, call, at)
            with pytest.raises(Died):
                run(tmp_path / "run", resume=True, marked=dies_at(1))
        assert load_result(tmp_path / "run").samples in (5, 6)
    with pytest.raises(Died):
        run(tmp_path / "run", resume=True, added=dies_at(1))
    assert load_result(tmp_path / "run").chunks == (1, 3, 1)
    with pytest.raises(Died):
        run(tmp_path / "run", resume=True, marked=dies_at(4))
    run(tmp_path / "run", resume=True)
    same_bits(load_result(tmp_path / "run").trajectory, whole)


def kill_call(patched, call, at):
    """Let a call of the operating system end the run, counted from 0."""
    real, calls = getattr(os, call), []

    def dying(*arguments, **options):
        calls.append(arguments)
        if len(calls) > at:
            raise Died
        return real(*arguments, **options)

    patched.setattr(os, call, dying)


def test_the_memory_matters(whole, tmp_path, monkeypatch):
    """Without the controller's memory the same run ends elsewhere: the tests above can fail."""
    with pytest.raises(Died):
        run(tmp_path / "run", marked=dies_at(7))
    real = Checkpoint.from_data.__func__

    def forgetful(cls, arrays, data):
        data["now"] = {"text": None}
        return real(cls, arrays, data)

    monkeypatch.setattr(Checkpoint, "from_data", classmethod(forgetful))
    run(tmp_path / "run", resume=True)
    found = load_result(tmp_path / "run").trajectory
    assert np.array_equal(found.q[:7], whole.q[:7])
    assert not np.array_equal(found.q[-1], whole.q[-1])


def test_what_was_left_over_goes(whole, tmp_path):
    """Files that a dying writer never named are neither read nor kept."""
    with pytest.raises(Died):
        run(tmp_path / "run", marked=dies_at(7))
    for name in ("chunk_0003.npz", "chunk_0009.npz", "checkpoint_0003.npz", "meta.json.part", "summary.json"):
        (tmp_path / "run" / name).write_bytes(b"left over")
    run(tmp_path / "run", resume=True)
    found = load_result(tmp_path / "run")
    assert found.note == ""
    same_bits(found.trajectory, whole)
    assert not (tmp_path / "run" / "chunk_0009.npz").exists()


def test_nothing_to_go_on_from(whole, tmp_path):
    """Where nothing was flushed the run begins: no folder, an empty one, or a writer that died at once."""
    (tmp_path / "empty").mkdir()
    filled(tmp_path / "begun", 1)
    resigned(tmp_path / "begun", samples=0, chunks=[], last_time=None)
    for name in ("none", "empty", "begun"):
        assert ResultWriter.resume(tmp_path / name, meta(), SCENE).start is None
    run(tmp_path / "begun", resume=True)
    same_bits(load_result(tmp_path / "begun").trajectory, whole)


def other(name, value):
    """Return options that make another run of it."""
    return lambda folder, made: ResultWriter.resume(folder, meta(**{name: value}), SCENE)


@pytest.mark.parametrize(
    ("go_on", "message"),
    [
        (other("step", 0.05), r"these differ: step \(0.1 there, 0.05 here\); try the original ones, or --overw"),
        (other("duration", 31.0), r"duration \(30.0 there, 31.0 here\)"),
        (other("scheme", "midpoint"), r"options.scheme \(None there, 'midpoint' here\)"),
        (lambda folder, made: ResultWriter.resume(folder, made, SCENE + "\n"), "these differ: the scene's text;"),
    ],
)
def test_another_run(go_on, message, tmp_path):
    """What would not end with the same bits is refused, and what differs is named; nothing is changed."""
    filled(tmp_path / "run", 2)
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(ResultError, match=message):
        go_on(tmp_path / "run", meta())
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_another_model_or_version(tmp_path, monkeypatch):
    """A robot's file that a scene names may change under the scene; NumPy's version has a part in the last bit."""
    filled(tmp_path / "run", 2)
    chain, _ = two_pandas("rigid", "ball")
    made = result_folder.run_meta(chain, "test", 30.0, 0.1)
    with pytest.raises(ResultError, match=r"these differ: the model that the scene describes, grasps.right"):
        ResultWriter.resume(tmp_path / "run", made, SCENE)
    monkeypatch.setattr(result_folder.np, "__version__", "9.0")
    with pytest.raises(ResultError, match=r"versions.numpy \('.*' there, '9.0' here\)"):
        ResultWriter.resume(tmp_path / "run", meta(), SCENE)


def test_a_run_that_has_ended(tmp_path):
    """A complete run, and one that physics stopped, say so."""
    w, _ = filled(tmp_path / "complete", 2)
    w.finish(None)
    with pytest.raises(ResultError, match=r"nothing to resume: the run is complete, 2 samples up to t = 0.1 s"):
        ResultWriter.resume(tmp_path / "complete", meta(), SCENE)
    w, _ = filled(tmp_path / "stopped", 2)
    w.finish(None, stopped="stopped after t = 0.1 s: the rank drops")
    with pytest.raises(ResultError, match=r"nothing to resume: stopped after t = 0.1 s: the rank drops"):
        ResultWriter.resume(tmp_path / "stopped", meta(), SCENE)


@pytest.mark.parametrize(
    ("name", "spoil", "message"),
    [
        (
            "checkpoint_0007.npz",
            lambda path: path.unlink(),
            "checkpoint_0007.npz is missing; it cannot be resumed; try --overwrite",
        ),
        ("checkpoint_0007.npz", lambda path: path.write_bytes(path.read_bytes()[:-9]), "checkpoint_0007.npz is dam"),
        ("chunk_0001.npz", lambda path: path.write_bytes(path.read_bytes()[:500]), "chunk_0001.npz is damaged"),
        ("meta.json", lambda path: path.write_bytes(path.read_bytes()[:500]), "meta.json is damaged: not valid JSON"),
        (
            "checkpoint_0007.npz",
            lambda path: (np.savez(path, data=np.array("{}")), resigned(path.parent)),
            "checkpoint: cannot be read: ",
        ),
    ],
)
def test_a_damaged_run(name, spoil, message, tmp_path):
    """It is refused by the name of the file, before anything is changed."""
    with pytest.raises(Died):
        run(tmp_path / "run", marked=dies_at(7))
    spoil(tmp_path / "run" / name)
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(ResultError, match=message):
        run(tmp_path / "run", resume=True)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_two_writers(tmp_path):
    """A run that is resumed while it still goes on is not mixed with itself: the later flush is refused."""
    with pytest.raises(Died):
        run(tmp_path / "run", marked=dies_at(4))
    chain, _ = remembering.unlimited()
    made = result_folder.run_meta(chain, "remembering", remembering.DURATION, remembering.STEP)
    first, second = (ResultWriter.resume(tmp_path / "run", made, remembering.SCENE) for _ in range(2))
    for w, count in ((first, 1), (second, 2)):
        for one in samples(count, 10):
            w.add(one)
    first.flush()
    for again in (second.flush, lambda: second.finish(None)):
        with pytest.raises(ResultError, match="another process has written to it"):
            again()
    assert load_result(tmp_path / "run").samples == 5
    replaced = writer(tmp_path / "run", overwrite=True)
    replaced.add(samples(1)[0])
    replaced.flush()
    first.add(samples(1)[0])
    with pytest.raises(ResultError, match="another process has written to it"):
        first.flush()
