"""Recordings with faults: which are refused, which are remarked on, which go unseen.

    python -m benchmarks.faulty_recordings --count 2000

Every recording is that of a random motion of an arm of three joints with friction and noise, spoilt in one way, written
to a file, read and identified, as `holdfast identify` does it. Counted is, by kind of fault, whether there is an error,
or a remark that names the column; whether one says what is not the cause; and what remains. Sound recordings are among
them, of which nothing may be said. A traceback, or an error of another kind, ends the count.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from holdfast.errors import HoldfastError
from holdfast.identification import Recording, assess, load_recording, measurement_errors

N, SAMPLES = 3, 90
NAMES = [f"arm/joint{k + 1}" for k in range(N)]
SCENE = """
simulation = { duration = 0.1, step = 0.01 }
[[arms]]
name = "arm"
[[arms.joints]]
link = { mass = 5.0, box = [0.1, 0.1, 0.3], com = [0.02, 0, 0.1] }
position_limits = [-2.9, 2.9]
[[arms.joints]]
position = [0, 0, 0.3]
axis = [0, 1, 0]
link = { mass = 4.0, box = [0.1, 0.1, 0.5], com = [0, 0, 0.2] }
position_limits = [-2.2, 2.2]
[[arms.joints]]
position = [0, 0, 0.5]
axis = [0, 1, 0]
link = { mass = 2.0, box = [0.08, 0.08, 0.4], com = [0.03, 0, 0.15] }
position_limits = [-2.8, 2.8]
[recording.arms.arm]
position = { columns = "q{1}" }
velocity = { columns = "qd{1}" }
torque = { columns = "tau{1}" }
"""
DIGITS = "\n0123456789.e-"
Columns = dict[str, Any]
Random = np.random.Generator


def arm() -> tuple[hf.ClosedChain, Any]:
    """Return the arm, and how its recordings are read."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(SCENE, encoding="utf-8")
        scenario = hf.load_scene(path)
    return scenario.chain, scenario.recording


def sound(chain: hf.ClosedChain, random: Random) -> Columns:
    """Return the columns of a random motion, with friction and noise."""
    t = np.linspace(0.0, random.uniform(3.0, 6.0), SAMPLES)
    w, phase = random.uniform(1.5, 4.5, N), random.uniform(0.0, 2 * np.pi, N)
    size = random.uniform(0.4, 0.9, N)
    middle = random.uniform(-0.5, 0.5, N)
    x = w * t[:, None] + phase
    q, qd, qdd = middle + size * np.sin(x), size * w * np.cos(x), -size * w**2 * np.sin(x)
    motion = Recording(t=t, q=q, qd=qd, qdd=qdd, tau=0.0 * q)
    tau = -measurement_errors(chain, motion, "tau") + 0.3 * qd + 0.5 * np.tanh(qd / 0.05)
    tau += 0.02 * tau.std(axis=0) * random.normal(size=tau.shape)
    found: Columns = {"t": t}
    for name, array in (("q", q), ("qd", qd), ("tau", tau)):
        found |= {f"{name}{k + 1}": array[:, k].copy() for k in range(N)}
    return found


def one_of(random: Random, *kinds: str) -> str:
    """Return a random column of some kinds."""
    return f"{random.choice(kinds)}{random.integers(N) + 1}"


# Each fault changes the columns, or the text of the file, and returns the columns of which one must be named.


def _scaled(factors: list[float], *kinds: str, every: bool = False) -> Callable[[Columns, Random], list[str]]:
    def spoil(columns: Columns, random: Random) -> list[str]:
        kind, factor = str(random.choice(kinds)), float(random.choice(factors))
        names = [f"{kind}{k + 1}" for k in range(N)] if every else [one_of(random, kind)]
        for name in names:
            columns[name] = columns[name] * factor
        return names

    return spoil


def _times(factors: list[float]) -> Callable[[Columns, Random], list[str]]:
    def spoil(columns: Columns, random: Random) -> list[str]:
        columns["t"] = columns["t"] * float(random.choice(factors))
        return ["t", "times"]

    return spoil


def _swapped(*kinds: str) -> Callable[[Columns, Random], list[str]]:
    def spoil(columns: Columns, random: Random) -> list[str]:
        kind, (i, j) = str(random.choice(kinds)), random.choice(N, 2, replace=False) + 1
        columns[f"{kind}{i}"], columns[f"{kind}{j}"] = columns[f"{kind}{j}"], columns[f"{kind}{i}"]
        return [f"{kind}{i}", f"{kind}{j}"]

    return spoil


def _cells(text: str, most: int = 5) -> Callable[[Columns, Random], list[str]]:
    def spoil(columns: Columns, random: Random) -> list[str]:
        name = str(random.choice([*columns]))
        cells = [repr(float(x)) for x in columns[name]]
        for k in random.choice(SAMPLES, int(random.integers(1, most)), replace=False).tolist():
            cells[k] = text
        columns[name] = cells
        return [name]

    return spoil


def _constant(columns: Columns, random: Random) -> list[str]:
    name = one_of(random, "q", "qd", "tau")
    columns[name] = np.full(SAMPLES, float(random.choice([0.0, float(columns[name][0])])))
    return [name]


def _repeated(columns: Columns, random: Random) -> list[str]:
    k = int(random.integers(1, SAMPLES))
    columns["t"][k] = columns["t"][k - 1]
    return ["t"]


def _back(columns: Columns, random: Random) -> list[str]:
    k = int(random.integers(2, SAMPLES - 2))
    columns["t"][k:] -= columns["t"][k]
    return ["t"]


def _gap(columns: Columns, random: Random) -> list[str]:
    first = int(random.integers(10, SAMPLES // 2))
    keep = np.r_[0:first, first + int(random.integers(22, 30)) : SAMPLES]
    for name in columns:
        columns[name] = np.asarray(columns[name])[keep]
    return ["t"]


def _absent(columns: Columns, random: Random) -> list[str]:
    name = str(random.choice([*columns]))
    del columns[name]
    return [name]


def _named_twice(columns: Columns, random: Random) -> list[str]:
    name, other = random.choice([*columns], 2, replace=False).tolist()
    columns[f"{name} "] = columns.pop(other)  # the same name after spaces are cut
    return [name, other]


def _nothing(columns: Columns, random: Random) -> list[str]:
    return []


IN_COLUMNS: dict[str, Callable[[Columns, Random], list[str]]] = {
    "sound": _nothing,
    "positions in degrees, one joint": _scaled([180 / np.pi], "q"),
    "positions in degrees, all": _scaled([180 / np.pi], "q", every=True),
    "rates in degrees or rpm, one joint": _scaled([180 / np.pi, 30 / np.pi], "qd"),
    "rates in degrees or rpm, all": _scaled([180 / np.pi, 30 / np.pi], "qd", every=True),
    "torques in mN m, N cm or kgf m, one joint": _scaled([1e3, 1e2, 1 / 9.81], "tau"),
    "torques in mN m, N cm or kgf m, all": _scaled([1e3, 1e2, 1 / 9.81], "tau", every=True),
    "times in ms, us or ns": _times([1e3, 1e6, 1e9]),
    "times divided by 1000": _times([1e-3]),
    "positions swapped": _swapped("q"),
    "rates swapped": _swapped("qd"),
    "torques swapped": _swapped("tau"),
    "sign of a position": _scaled([-1.0], "q"),
    "sign of a rate": _scaled([-1.0], "qd"),
    "sign of a torque": _scaled([-1.0], "tau"),
    "NaN": _cells("nan"),
    "empty cells": _cells(""),
    "infinity": _cells("inf"),
    "texts": _cells("ERR"),
    "decimal commas": _cells('"1,5"'),
    "constant channel": _constant,
    "repeated stamp": _repeated,
    "clock set back": _back,
    "gap": _gap,
    "absent column": _absent,
    "column named twice": _named_twice,
}


def as_text(columns: Columns) -> str:
    """Return columns as a CSV table."""
    rows = zip(*([x if isinstance(x, str) else repr(float(x)) for x in of] for of in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(row) for row in rows)]) + "\n"


def _cut_line(text: str, random: Random) -> bytes:
    lines = text.splitlines()
    k = int(random.integers(1, len(lines)))
    lines[k] = lines[k].rpartition(",")[0] if random.random() < 0.5 else lines[k] + ",1.0"
    return "\n".join(lines).encode()


def _cut_file(text: str, random: Random) -> bytes:
    return text[: int(random.integers(200, len(text) - 40))].rstrip(DIGITS).encode()


def _noise_bytes(text: str, random: Random) -> bytes:
    return random.bytes(2000)


IN_FILES: dict[str, tuple[str, Callable[[str, Random], bytes]]] = {
    "UTF-16": (".csv", lambda text, random: text.encode("utf-16")),
    "Latin-1": (".csv", lambda text, random: text.replace("tau1", "\xe9ffort1", 1).encode("latin-1")),
    "null bytes": (".csv", lambda text, random: text.encode().replace(b"\n", b"\n\0", 5)),
    "empty file": (".csv", lambda text, random: b""),
    "header only": (".csv", lambda text, random: text.splitlines()[0].encode()),
    "no header": (".csv", lambda text, random: text.partition("\n")[2].encode()),
    "a line too short or too long": (".csv", _cut_line),
    "file cut off": (".csv", _cut_file),
    "no .npz": (".npz", _noise_bytes),
    "no .parquet": (".parquet", _noise_bytes),
    "no .mcap": (".mcap", _noise_bytes),
}  # fmt: skip


def _arrays_of_other_lengths(path: Path, columns: Columns, random: Random) -> list[str]:
    name = str(random.choice([*columns]))
    columns[name] = columns[name][: -int(random.integers(1, 9))]
    np.savez(path, **columns)
    return [name]


def said_of(chain: hf.ClosedChain, how: Any, path: Path) -> tuple[str, str]:
    """Return "error", "remark" or "nothing", and what was said."""
    try:
        found = assess(chain, load_recording(path, chain, columns=how), by="tau", unknowns=["damping", "friction"])
    except HoldfastError as cause:
        return "error", str(cause)
    remarks = [*found.criteria, *(note for note in found.found.notes if "most likely" in note or "rows" in note)]
    return ("remark", "; ".join(remarks)) if remarks else ("nothing", "")


def judged(kind: str, outcome: str, said: str, names: list[str], path: Path) -> str:
    """Return in which column of the table a recording counts."""
    if kind == "sound":
        return "rightly silent" if outcome == "nothing" else "false alarm"
    if outcome == "nothing":
        return "unseen"
    joints = {name: f"{name.rstrip('123')} of '{NAMES[int(name[-1]) - 1]}'" for name in names if name[-1].isdigit()}
    shown = [path.name] if not names else [*names, *joints.values(), *(f"'{NAMES[int(n[-1]) - 1]}'" for n in joints)]
    named = any(re.search(rf"(?<!\w)(?<!\w'){re.escape(one)}(?![\w])", said) for one in shown)
    return f"named {outcome}" if named else f"{outcome} without the column"


def count(number: int, seed: int = 0, show: bool = True) -> Counter[tuple[str, str]]:
    """Return how many recordings of each kind of fault met which fate."""
    chain, how = arm()
    table: Counter[tuple[str, str]] = Counter()
    kinds, begun = [*IN_COLUMNS, *IN_FILES, "arrays of other lengths"], time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(number):
            random, kind = np.random.default_rng([seed, k]), kinds[k % len(kinds)]
            columns, names = sound(chain, random), list[str]()
            path = Path(folder) / "log.csv"
            if kind in IN_COLUMNS:
                names = IN_COLUMNS[kind](columns, random)
                path.write_text(as_text(columns), encoding="utf-8")
            elif kind in IN_FILES:
                suffix, spoil = IN_FILES[kind]
                path = Path(folder) / f"log{suffix}"
                path.write_bytes(spoil(as_text(columns), random))
            else:
                path = Path(folder) / "log.npz"
                names = _arrays_of_other_lengths(path, columns, random)
            outcome, said = said_of(chain, how, path)
            fate = judged(kind, outcome, said, names, path)
            table[kind, fate] += 1
            if show and fate not in GOOD:
                print(f"{k:>5} {kind}, {', '.join(names)}: {fate}: {said[:240]}")
    if show:
        _print(table, number, time.perf_counter() - begun)
    return table


FATES = ("named error", "named remark", "error without the column", "remark without the column", "unseen",
         "rightly silent", "false alarm")  # fmt: skip
GOOD = ("named error", "named remark", "rightly silent")


def _print(table: Counter[tuple[str, str]], number: int, seconds: float) -> None:
    """Print the table."""
    kinds = list(dict.fromkeys(kind for kind, _ in table))
    print(f"{'fault':<44}" + "".join(f"{fate:>27}" for fate in FATES))
    for kind in kinds:
        print(f"{kind:<44}" + "".join(f"{table[kind, fate] or '.':>27}" for fate in FATES))
    print(f"{'all':<44}" + "".join(f"{sum(table[kind, fate] for kind in kinds):>27}" for fate in FATES))
    print(f"{number} recordings, no traceback, {seconds:.0f} s")


def main() -> int:
    """Count, and return 1 if a fault went unseen or was said of no column, or something sound was suspected."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    table = count(given.count, given.seed)
    return int(any(fate not in GOOD for _, fate in table))


if __name__ == "__main__":
    sys.exit(main())
