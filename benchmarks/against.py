"""Random runs of `simulate` by an earlier commit and by the working tree: are they the same?

Each version makes all runs in a process of its own with an empty cache of machine code; the earlier one's sources come
from a worktree of Git that is removed at the end. `run_differences` states the bars; exit status 1 if any is broken.
What breaks its bar is held against runs of the commit whose state at the start is changed by 1e-15, some of them by
another BLAS kernel: it is explained by rounding if it is within 100 times of what these do.

With `--blas Prescott` the working tree computes by another BLAS kernel: against HEAD this shows what rounding does.

A run that takes longer than `--longest` seconds of processor time is named and not compared.

python benchmarks/against.py COMMIT [--scenes 500] [--seed 0] [--jobs 2] [--only SEED ...] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import hashlib
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.run_differences import ADAPTIVE, AFTER, BEFORE, INSTANTS, Difference, Record, differences

ROOT = Path(__file__).parents[1]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HOLDFAST_COMPILE": "quick"}
NUDGES, OTHER_BLAS = (1, 2, 3, 4), "Prescott"
MEASURES = {"before": BEFORE, "after": AFTER, "adaptive": ADAPTIVE, "instants": INSTANTS}


def recorded(seed: int, nudge: int = 0) -> Record:
    """Return a `random_run` as plain data: its arrays, its log, how it ended, or the error that it raised."""
    import holdfast as hf
    from benchmarks.random_runs import random_run

    begin = time.process_time()
    made = random_run(seed, nudge)
    found: Record = {"family": made.family, "options": made.options, "tolerance": made.tolerance}
    found |= {"arrays": {}, "stopped": None, "occurrences": [], "error": None}
    try:
        run = made.make()
    except Exception as error:  # whatever a version raises, the other one has to raise as well
        found["error"] = f"{type(error).__name__}: {error}"
    else:
        every = {one.name: getattr(run, one.name) for one in fields(hf.simulation.Trajectory)}
        found["arrays"] = {name: np.array(x) for name, x in every.items() if isinstance(x, np.ndarray)}
        found["stopped"] = run.stopped
        found["occurrences"] = [asdict(one) for one in run.occurrences]
    found["seconds"] = time.process_time() - begin
    return found


class TooLong(BaseException):
    """A run took longer than it may; no `except Exception` of the library stops it."""


def _end(*_: object) -> None:
    raise TooLong


def record(folder: Path, sources: Path, nudge: int, longest: int, seeds: list[int]) -> None:
    """Record runs into files of a folder, those that are not there yet; of one that takes too long, an empty record."""
    import holdfast as hf

    if not Path(hf.__file__).is_relative_to(sources):
        raise SystemExit(f"expected the sources of {sources}, got {hf.__file__}")
    signal.signal(signal.SIGPROF, _end)
    for k, seed in enumerate(seeds, start=1):
        path = _file(folder, seed)
        if not path.exists():
            part = path.with_suffix(".part")
            signal.setitimer(signal.ITIMER_PROF, longest)
            try:
                run = recorded(seed, nudge)
            except TooLong:
                run = {}
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
            part.write_bytes(pickle.dumps(run))
            part.replace(path)
        if k % 10 == 0 or k == len(seeds):
            print(f"{folder.name}: {k} of {len(seeds)} runs", file=sys.stderr, flush=True)


def _file(folder: Path, seed: int) -> Path:
    return folder / f"{seed}.pickle"


@contextmanager
def worktree(commit: str) -> Iterator[Path]:
    """Check a commit out into a temporary folder within this context."""
    with tempfile.TemporaryDirectory(prefix="holdfast-against-") as temporary:
        path = Path(temporary) / "commit"
        _git("worktree", "add", "--quiet", "--detach", str(path), commit)
        try:
            yield path
        finally:
            _git("worktree", "remove", "--force", str(path))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True).stdout


class Job(NamedTuple):
    """Runs to be recorded in one process.

    Attributes:
        folder: where.
        sources: of the version that makes them.
        nudge: as for `random_run`.
        longest: processor time that a run may take [s].
        seeds: of the runs.
        blas: kernel of OpenBLAS; "" for that of the processor.
    """

    folder: Path
    sources: Path
    nudge: int
    longest: int
    seeds: list[int]
    blas: str = ""

    def start(self) -> subprocess.Popen[bytes]:
        """Start the process."""
        cache = self.folder / "cache"
        cache.mkdir(mode=0o700, parents=True, exist_ok=True)
        env = os.environ | ONE_THREAD | {"PYTHONPATH": str(self.sources), "HOLDFAST_CACHE": str(cache)}
        env |= {"OPENBLAS_CORETYPE": self.blas} if self.blas else {}
        given = [self.folder, self.sources, self.nudge, self.longest, *self.seeds]
        return subprocess.Popen([sys.executable, __file__, "--record", *map(str, given)], env=env)


def finish(waiting: Sequence[Job], jobs: int) -> None:
    """Start processes, so many at a time, and wait for all of them."""
    waiting, running = [*waiting], []
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                running.append(waiting.pop(0).start())
            time.sleep(0.1)
            running = [one for one in running if one.poll() is None]
    finally:
        for one in running:
            one.kill()


def _digest() -> str:
    """Return a digest of what the runs are made of, apart from the library."""
    made_of = [
        *ROOT.glob("benchmarks/random_*.py"),
        *ROOT.glob("tests/systems/*.py"),
        *ROOT.glob("tests/simulation/*.py"),
    ]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(made_of))).hexdigest()


def ends(run: Record) -> Iterator[str]:
    """Yield in words what happened in a run."""
    kinds = Counter(one["kind"] for one in run["occurrences"])
    yield from kinds
    if run["error"]:
        yield "raised"
    elif run["stopped"]:
        yield "slip" if re.search(r"slips|lifts off|gives way|tips", run["stopped"]) else "ended early"
    else:
        yield "complete"


def compared(seed: int, *folders: Path) -> Difference | None:
    """Return the difference of a run between two folders, None if one of them does not have it or it took too long."""
    runs = [_loaded(path) for folder in folders if (path := _file(folder, seed)).exists()]
    return differences(*runs) if len(runs) == len(folders) and all(runs) else None


def _loaded(path: Path) -> Record:
    return pickle.loads(path.read_bytes())


def nudged(folder: Path, nudge: int) -> Path:
    """Return the folder of runs whose state is changed by rounding errors."""
    return folder.with_name(f"{folder.name}, nudge {nudge}")


def report(old: Path, new: Path, seeds: list[int]) -> int:
    """Print how far all runs are apart by family, what happened in them, and what failed; return how many did."""
    rows: dict[str, list[tuple[Difference, set[Any]]]] = defaultdict(list)
    happened: dict[str, Counter[str]] = defaultdict(Counter)
    failed: list[str] = []
    seconds = np.zeros(2)
    late = [seed for seed in seeds if (path := _file(old, seed)).exists() and not _loaded(path)]
    for seed in (seed for seed in seeds if seed not in late):
        found = compared(seed, old, new)
        if found is None:
            failed.append(f"seed {seed}: the working tree took too long, or its process ended before it was recorded")
            continue
        rounding = [one for k in NUDGES if (one := compared(seed, old, nudged(old, k))) is not None]
        explained, runs = found.explained(rounding), [_loaded(_file(folder, seed)) for folder in (old, new)]
        family = runs[0]["family"]
        rows[family].append((found, explained))
        happened[family].update(ends(runs[0]))
        seconds += [run["seconds"] for run in runs]
        left = [text for key, text in found.failures.items() if key not in explained]
        failed += [f"seed {seed} ({family}; {runs[0]['options']}): {'; '.join(left)}"] if left else []
    columns = [*(f"{how:>10}" for how in MEASURES), f"{'same':>6}{'ill':>5}  what happened"]
    print(f"{'family':20}{'runs':>5}" + "".join(columns))
    print(f"{'bar':25}" + "".join(f"{bar:10.0e}" for bar in MEASURES.values()))
    for family, found in rows.items():
        print(_row(family, found, happened[family]))
    print(_row("all", [one for found in rows.values() for one in found], sum(happened.values(), Counter())))
    print("same: all within bars; ill: what is not is explained by rounding, and left out of the columns before")
    print(f"processor time: {seconds[0]:.0f} s by the commit, {seconds[1]:.0f} s by the working tree")
    if late:
        print(f"not compared, for the commit did not finish them in time: {', '.join(map(str, late))}")
    for line in failed:
        print(line)
    return len(failed)


def _row(family: str, found: list[tuple[Difference, set[Any]]], happened: Counter[str]) -> str:
    worst = [max((one.worst(how, explained) for one, explained in found), default=0.0) for how in MEASURES]
    said = ", ".join(f"{what} {count}" for what, count in happened.most_common())
    same = sum(not one.failures for one, _ in found)
    ill = sum(bool(one.failures) and one.failures.keys() <= explained for one, explained in found)
    return f"{family:20}{len(found):5}" + "".join(f"{x:10.1e}" for x in worst) + f"{same:6}{ill:5}  {said}"


def main() -> None:
    """Compare the working tree with a commit."""
    if sys.argv[1:2] == ["--record"]:
        folder, sources, nudge, longest, *seeds = sys.argv[2:]
        record(Path(folder), Path(sources), int(nudge), int(longest), [int(seed) for seed in seeds])
        return
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("commit", help="the earlier commit")
    parser.add_argument("--scenes", type=int, default=500, help="number of runs")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first run")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes")
    parser.add_argument("--only", type=int, nargs="+", help="seeds of the runs, instead of --scenes and --seed")
    parser.add_argument("--keep", type=Path, help="folder for the commit's runs, which are not made again next time")
    parser.add_argument("--longest", type=int, default=600, help="processor time that a run may take [s]")
    parser.add_argument("--blas", default="", help="OPENBLAS_CORETYPE of the working tree's runs")
    chosen = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the worktree is removed
    seeds = chosen.only or [*range(chosen.seed, chosen.seed + chosen.scenes)]
    commit = _git("rev-parse", "--verify", f"{chosen.commit}^{{commit}}").strip()
    with worktree(commit) as checkout, tempfile.TemporaryDirectory(prefix="holdfast-runs-") as temporary:
        old = (chosen.keep or Path(temporary)) / f"commit {commit[:12]}, runs {_digest()[:8]}"
        new = Path(temporary) / "working tree"
        tree = Path(temporary) / "src"
        shutil.copytree(ROOT / "src", tree)  # so that the tree can be edited meanwhile
        versions = (old, checkout / "src", ""), (new, tree, chosen.blas)
        parts = [seeds[k :: max(1, chosen.jobs // 2)] for k in range(max(1, chosen.jobs // 2))]
        finish([Job(to, of, 0, chosen.longest, part, blas) for part in parts for to, of, blas in versions], chosen.jobs)
        doubtful = [seed for seed in seeds if (found := compared(seed, old, new)) and found.failures]
        again = [
            Job(nudged(old, k), checkout / "src", k, chosen.longest, doubtful, OTHER_BLAS * (k % 2)) for k in NUDGES
        ]
        finish(again if doubtful else [], chosen.jobs)
        failures = report(old, new, seeds)
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
