"""Random scenes from the command line: each ends with a result or a named refusal, none with a traceback, NaN or hang.

HOLDFAST_SCENES=100 takes the first hundred only."""

from __future__ import annotations

import faulthandler
import json
import os
import re
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import holdfast.cli.simulate as command
from holdfast import ClosedChain, HoldfastError, load_scene
from holdfast.cli import main
from holdfast.cli.streams import EXIT_INTERRUPTED
from holdfast.io.result_reader import load_result
from holdfast.simulation.trajectory import array_names
from tests.scenario.mutated_scenes import mutated, prepare
from tests.systems.random_scenes import random_scene

COUNT = int(os.environ.get("HOLDFAST_SCENES", "2000"))
PARTS = 20
LONGEST = 1800  # seconds for one scene (arms flung to 1e5 rad/s take minutes), then every thread's stack is shown

MAY_BE_INFINITE = {"margin", "best_margin", "worst_margin", "lowest_margin", "lowest_joint_margin"}


def outcome(seed: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return how the run of a scene ended, in few words, having asserted that it ended well."""
    scene = folder / f"scene{seed}.toml"
    scene.write_text(random_scene(seed))
    out = folder / f"result{seed}"
    faulthandler.dump_traceback_later(LONGEST, exit=True, file=sys.__stderr__)
    try:
        code = main(["simulate", str(scene), "--out", str(out), "--no-plots"])
    finally:
        faulthandler.cancel_dump_traceback_later()
    said = capsys.readouterr()
    assert code in (0, 2, 3), seed
    problems = [line for line in said.err.splitlines() if line.startswith("holdfast: error:")]
    others = [line for line in said.err.splitlines() if not line.startswith(("holdfast: error:", "simulating"))]
    assert not others, (seed, others)
    assert len(problems) == (code != 0), (seed, said.err)
    assert not re.search(r"\bnan\b|\binf\b|Traceback", said.out + said.err), (seed, said.out, said.err)
    if not out.exists():
        assert code != 0, seed
        return re.sub(r"[-+]?\d[\w.+-]*|'[^']*'|\S*scene\S*:", "", problems[0])[17:57].strip()
    sound(out, seed)
    return "complete" if code == 0 else "stopped: " + re.sub(r"\d|arm", "", problems[0].split("toml:")[1])[:30].strip()


def sound(out: Path, seed: int) -> None:
    """Assert that a result folder is whole: finite numbers, closed grasps, times that increase."""
    found = load_result(out)
    run = found.trajectory
    for name in array_names():
        array = getattr(run, name)
        assert not np.isnan(array).any(), (seed, name)
        assert name in MAY_BE_INFINITE or np.isfinite(array).all(), (seed, name)
    assert (np.diff(run.t) > 0).all(), seed
    assert run.position_gap[:, 1].max() <= 1e-9, seed
    json.loads((out / "summary.json").read_text(), parse_constant=lambda word: pytest.fail(f"{seed}: {word}"))


def survive(seeds: range, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Run the scenes and print how often they ended how."""
    begin = time.perf_counter()
    ends = Counter(outcome(seed, folder, capsys) for seed in seeds)
    with capsys.disabled():
        print(f"\n{len(seeds)} scenes in {time.perf_counter() - begin:.0f} s:")
        for words, times in ends.most_common():
            print(f"{times:6d}  {words}")


@pytest.mark.slow
def test_some_scenes(tmp_path, capsys):
    """Two quick ones: one that slips, one flung too fast; those out of reach and with impossible events are below."""
    for seed in (1, 938):
        outcome(seed, tmp_path, capsys)


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_all_scenes(part, tmp_path, capsys):
    """All of them, in parts that can go side by side."""
    survive(range(part, COUNT, PARTS), tmp_path, capsys)


MUTATED, MUTATED_PARTS = 3000, 6
SECONDS = 10.0
GIGABYTES = 1.0
LONGEST_MESSAGE = 600
ARM_STEPS = 8  # steps times arms, then comes Ctrl-C
SEEN = 10  # every so many scenes are viewed too
CODES = {0: "complete", 2: "refused by the run", 3: "stopped by physics", 130: "interrupted"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the files that scenes name; runs in it are interrupted after a few steps."""
    prepare(tmp_path)
    monkeypatch.setattr(command, "run_simulation", of_few_steps(command.run_simulation))
    return tmp_path


def of_few_steps(simulation: Callable[..., Any]) -> Callable[..., Any]:
    """Return a simulation during which the user loses patience."""

    def run(chain: ClosedChain, *arguments: Any, progress: Callable[[float], None], **options: Any) -> Any:
        steps = 0

        def impatient(t: float) -> None:
            nonlocal steps
            steps += 1
            if steps * len(chain.arms) >= ARM_STEPS:
                raise KeyboardInterrupt
            progress(t)

        return simulation(chain, *arguments, progress=impatient, **options)

    return run


def end(scene: Path, seed: int, capsys: pytest.CaptureFixture[str]) -> str:
    """Return how a scene ended, having asserted that it ended well."""
    try:
        load_scene(scene)
    except HoldfastError as refused:
        said = str(refused)
        assert said.startswith(f"{scene}: "), said[:300]
        assert len(said) <= LONGEST_MESSAGE and said.isprintable(), said
        code = 0
    else:
        said, out = "", scene.parent / f"result{seed}"
        code = main(["simulate", str(scene), "--out", str(out), "--no-plots"])
        assert_printed(scene, code, capsys)
        if out.exists() and code != EXIT_INTERRUPTED:
            sound(out, seed)
        assert out.exists() or code, seed
    if seed % SEEN == 0:
        page = scene.parent / "page.html"
        shown = main(["view", str(scene), "--export", str(page), "--overwrite"])
        assert_printed(scene, shown, capsys)
        assert not (said and shown == 0), seed
    return f"refused: {type_of(said)}" if said else CODES[code]


def assert_printed(scene: Path, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Assert that a command said on stderr what is wrong, in one line, and nothing that is not finite."""
    printed = capsys.readouterr()
    prefix = "holdfast: error: "
    problems = [line.removeprefix(prefix) for line in printed.err.splitlines() if line.startswith(prefix)]
    others = [line for line in printed.err.splitlines() if not line.startswith(prefix)]
    assert code in CODES, printed.err
    assert len(problems) == (code != 0), printed.err
    assert all(line.startswith((f"{scene}: ", "interrupted after")) for line in problems), printed.err
    assert all(line.startswith(("simulating ", "note: ")) for line in others), printed.err
    assert all(line.isprintable() and len(line) <= LONGEST_MESSAGE for line in [*problems, *others]), printed.err
    assert not re.search(r"\b(nan|inf)\b|Traceback", printed.out), printed.out
    assert not re.search(r"(?<!got )(?<!got -)\b(nan|inf)\b", printed.err), printed.err  # "got nan" quotes the scene


def type_of(said: str) -> str:
    """Return in a word what a refusal is about."""
    kinds = ("not valid TOML", "Object contains unknown", "Object missing", "Expected", "Invalid", "cannot be read")
    kinds += ("expected a number up to", "expected a finite", "assemble: ", "cannot close", "expected", "no ")
    return next((kind for kind in kinds if kind in said), "other").strip(": ")


def fuzz(seeds: range, folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[Counter[str], float]:
    """Return how often what came of the scenes, and the longest time one took [s]."""
    ends: Counter[str] = Counter()
    longest = 0.0
    scene = folder / "scene.toml"
    for seed in seeds:
        name, data = mutated(seed)
        scene.write_bytes(data)
        start = time.process_time()
        ends[end(scene, seed, capsys)] += 1
        took = time.process_time() - start
        longest = max(longest, took)
        assert took < SECONDS, (seed, name, took)
    return ends, longest


@pytest.mark.slow
def test_mutated_scenes(folder, capsys):
    """A few: none escapes as another exception."""
    ends, _ = fuzz(range(12), folder, capsys)
    assert len(ends) > 4


@pytest.mark.long
@pytest.mark.parametrize("part", range(MUTATED_PARTS))
def test_3000_mutated_scenes(part, folder, capsys):
    """Of 3,000, in parts that can go side by side."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    ends, longest = fuzz(range(part, MUTATED, MUTATED_PARTS), folder, capsys)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 2**20
    with capsys.disabled():
        for how, count in ends.most_common():
            print(f"{count:5d}  {how}")
        print(f"{ends.total():5d}  scenes, the longest {longest:.1f} s, {grown:.2f} GiB more at most")
    assert grown < GIGABYTES
