"""`kill -9` at any moment, inside any flush: the folder opens, holds every flushed step, goes on to the same bits.

One run is a scene from the command line, in which an arm lets go; the other a run from Python whose
controller remembers. Both are long enough to be stepped by machine code; the short test is not.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from holdfast.io.result_reader import Result, load_result
from tests.io.recorded import same_bits

ROOT = Path(__file__).parents[2]
KILLS = 20
FIRST, A_FLUSH = 3, 3  # moves before the first flush is through its first file, and in each flush

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")


@dataclass(frozen=True)
class Run:
    """A run to kill.

    Attributes:
        place: where its folders are.
        arguments: of `tests.acceptance.dying`, a folder's place left open.
        whole: what it is if nobody kills it.
        seconds: how long it takes from the first flush to the end.
    """

    place: Path
    arguments: tuple[str, ...]
    whole: Result
    seconds: float

    @property
    def flushes(self) -> int:
        """How many the whole run has."""
        return len(self.whole.chunks)


def flushed(place: Path, name: str) -> int:
    """Return how many samples are on disk for certain."""
    book = place / f"{name}.book"
    return int(book.read_text().split()[-1]) if book.exists() and book.read_text() else 0


def started(place: Path, name: str, arguments: tuple[str, ...], *more: str, at: int = 0) -> subprocess.Popen:
    """Return the process of a run into a folder of that name."""
    given = [argument.format(place / name) for argument in arguments]
    command = [sys.executable, "-m", "tests.acceptance.dying", str(place / f"{name}.book"), str(at), *given, *more]
    with (place / f"{name}.err").open("w") as complaints:
        return subprocess.Popen(
            command,
            cwd=ROOT,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=complaints,
        )


def wait_for_a_flush(process: subprocess.Popen, place: Path, name: str) -> None:
    """Wait until the first samples are on disk."""
    while not flushed(place, name):
        assert process.poll() is None, (place / f"{name}.err").read_text()
        time.sleep(0.002)


def made(place: Path, *arguments: str) -> Run:
    """Return a run, after letting it live once."""
    process = started(place, "whole", arguments)
    wait_for_a_flush(process, place, "whole")
    start = time.monotonic()
    assert process.wait(300) == 0, (place / "whole.err").read_text()
    return Run(place, arguments, load_result(place / "whole"), time.monotonic() - start)


def scene_run(place: Path, duration: float) -> Run:
    """Return the demo's scene, cut short; the right arm lets go in the middle."""
    text = (ROOT / "examples" / "two_pandas.toml").read_text().replace("duration = 2.0", f"duration = {duration}")
    text += f'\n[[events]]\ntype = "release"\narm = "right"\nt = {duration / 2}\n'
    (place / "scene.toml").write_text(text)
    return made(place, "simulate", str(place / "scene.toml"), "--out", "{}", "--no-plots")


def branches_run(place: Path, duration: float) -> Run:
    """Return the demo's scene beside a ball that falls, which makes it a forest, under a sampled controller."""
    text = (ROOT / "examples" / "two_pandas.toml").read_text().partition("[controller]")[0]
    text += f"""
[objects.ball]
mass = 1.0
sphere = 0.1
pose = {{ position = [0.0, 1.0, 1.0] }}

[controller]
type = "torque_schedule"
pieces = [{{ begin = 0.0, torques = {[[0.0, 9.0]] * 14} }}]

[[events]]
type = "release"
arm = "right"
t = {duration / 2}

[simulation]
duration = {duration}
step = 0.002
sample_time = 0.004
delay = 0.001
"""
    (place / "scene.toml").write_text(text)
    return made(place, "simulate", str(place / "scene.toml"), "--out", "{}", "--no-plots")


def remembering_run(place: Path, duration: float) -> Run:
    """Return the run whose controller remembers."""
    return made(place, "remembering", str(duration), "{}")


MAKE = {"scene": scene_run, "remembering": remembering_run, "branches": branches_run}
LONG = 0.24  # s: 120 steps


def require_recovery(run: Run, name: str) -> int:
    """Assert that a killed run opens, holds what was flushed, and goes on to the same bits; return its samples."""
    certain = flushed(run.place, name)
    if certain:
        found = load_result(run.place / name)
        assert not found.complete
        assert certain <= found.samples <= certain + 2  # the flush may have been through, and not yet in the book
        assert f"up to t = {found.trajectory.t[-1]:.6g} s" in found.note
        for array in run.whole.trajectory.recorded:
            head = getattr(run.whole.trajectory, array)[: found.samples]
            assert getattr(found.trajectory, array).tobytes() == head.tobytes(), array
    process = started(run.place, name, run.arguments, "--resume")
    assert process.wait(300) == 0, (run.place / f"{name}.err").read_text()
    ended = load_result(run.place / name)
    assert ended.complete
    assert ended.note == ""
    same_bits(ended.trajectory, run.whole.trajectory)
    for text in ("summary.json", "scene.toml"):
        if (run.place / "whole" / text).exists():
            assert (run.place / name / text).read_bytes() == (run.place / "whole" / text).read_bytes()
    return certain


def killed_at(run: Run, name: str, moment: float) -> bool:
    """Kill a run so many seconds after its first flush; return whether that was before its end."""
    process = started(run.place, name, run.arguments)
    wait_for_a_flush(process, run.place, name)
    time.sleep(moment)
    process.kill()
    process.wait()
    return not load_result(run.place / name).complete


def killed_in_flush(run: Run, name: str, flush: int, file: int) -> None:
    """Let a run die in a flush between the writing of one of its files and the move: chunk, checkpoint, meta."""
    process = started(run.place, name, run.arguments, at=FIRST + A_FLUSH * flush + file)
    assert process.wait(300) == -signal.SIGKILL
    assert flushed(run.place, name) == sum(run.whole.chunks[:flush])
    assert list((run.place / name).glob("*.part"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["remembering", "branches"])
def test_two_kills(kind, tmp_path):
    """In short: one at some moment, one inside a flush."""
    run = MAKE[kind](tmp_path, 0.024)
    tries = 1
    while not killed_at(run, f"moment{tries}", 0.3 * run.seconds / tries):
        tries += 1
    require_recovery(run, f"moment{tries}")
    killed_in_flush(run, "flush", 3, 2)
    assert require_recovery(run, "flush") == sum(run.whole.chunks[:3])


@pytest.mark.long
@pytest.mark.parametrize("kind", MAKE)
def test_killed_at_random_moments(kind, tmp_path):
    """Twenty of them between the first flush and the end."""
    run = MAKE[kind](tmp_path, LONG)
    rng, left, k = random.Random(0), [], 0
    while len(left) < KILLS:
        k += 1
        if killed_at(run, f"kill{k}", rng.uniform(0.0, run.seconds)):
            left.append(require_recovery(run, f"kill{k}"))
    print(f"\n{kind}: {len(left)} kills of {k} runs of {run.whole.samples} samples; flushed then: {left}")


@pytest.mark.long
@pytest.mark.parametrize("kind", MAKE)
def test_killed_inside_flushes(kind, tmp_path):
    """Twenty flushes, the first among them: death between the writing and the move of chunk, checkpoint or meta."""
    run = MAKE[kind](tmp_path, LONG)
    rng, left = random.Random(1), []
    for flush in [0, *sorted(rng.sample(range(1, run.flushes), KILLS - 1))]:
        killed_in_flush(run, f"kill{flush}", flush, rng.randrange(A_FLUSH))
        left.append(require_recovery(run, f"kill{flush}"))
    print(f"\n{kind}: {len(left)} kills in {run.flushes} flushes of {run.whole.samples} samples; flushed then: {left}")
