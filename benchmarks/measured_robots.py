"""Models and identification against measured robots: `python benchmarks/measured_robots.py FOLDER [ROBOT ...]`.

The folder has the logs of docs/measured_robots.md, which says where to get them; robots whose logs are not there are
left out. With `--convert SOURCE` logs are made from the sources' own files, somewhere below SOURCE. Each robot is one
function, which prints its table and returns whether its bars are met. Two UR5e are those of `measured_calibration`,
which predicts every further `dual_ur5e_*kg*.csv` of the folder.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import holdfast as hf
from benchmarks import measured_calibration
from holdfast.identification import Recording, measurement_errors, prepared
from holdfast.robots import gen3, panda

PUBLISHED = np.array([0.29, 0.59, 0.28, 0.31, 0.15, 0.10, 0.07])  # N m, with the friction of Gaz et al. 2019
PANDA_BAR = 1.1 * PUBLISHED
A = np.array([0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489])
B = np.array([5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336])
C = np.array([0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526])


def columns(path: Path, *names: str) -> list[np.ndarray]:
    """Return columns of a file, (samples, count) for each name that numbers complete, and (samples,) for others."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    titles = table.dtype.names or ()

    def one(name: str) -> np.ndarray:
        if name in titles:
            return table[name]
        return np.column_stack([table[f"{name}{k}"] for k in range(1, 8)])

    return [one(name) for name in names]


def rms(errors: np.ndarray) -> np.ndarray:
    """Return the root mean square of each column."""
    return np.sqrt((errors**2).mean(axis=0))


def line(title: str, values: np.ndarray) -> str:
    """Return a row of a table."""
    return f"{title:<52}" + " ".join(f"{x:6.3f}" for x in np.asarray(values).tolist())


def between(recording: Recording, start: float, end: float) -> Recording:
    """Return the samples of a recording within a part of its duration, from 0 to 1."""
    n = len(recording)
    of = slice(round(start * n), round(end * n))
    arrays = {f.name: getattr(recording, f.name) for f in fields(Recording)}
    return replace(recording, **{name: x[of] for name, x in arrays.items() if isinstance(x, np.ndarray)})


def panda_excitation(folder: Path) -> bool:
    """Panda: friction and drives from the first half of 21 s, residuals of the torques in the second half."""
    t, q, tau = columns(folder / "panda_excitation.csv", "t", "q", "tau")
    moved = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > 0.0)[0]
    given = Recording(t=t[moved:], q=q[moved:], tau=tau[moved:])
    ready, report = prepared(given, cutoff=10.0)
    print(report)
    chain = hf.ClosedChain({"arm": panda()})
    first, second = between(ready, 0.0, 0.5), between(ready, 0.5, 1.0)
    plain = measurement_errors(chain, second, "tau")
    published = A / (1.0 + np.exp(-B * (second.qd + C))) - A / (1.0 + np.exp(-B * C))
    print(line("rms torque, second half [N m]", rms(np.asarray(second.tau))))
    print(line("residual of the model as it is", rms(plain)))
    print(line("with the published friction", rms(plain - published)))
    print(line("bar: 1.1 times the published residual, whole log", PANDA_BAR))
    results = []
    for title, kinds in {
        "friction": ("damping", "friction", "friction_offset"),
        "friction and armature": ("armature", "damping", "friction", "friction_offset"),
        "friction, armature and links": ("links", "armature", "damping", "friction", "friction_offset"),
    }.items():
        found = hf.identify(chain, first, by="tau", unknowns=kinds)
        left = rms(measurement_errors(found.chain, second, "tau", found.others))
        print(line(f"{title}: first half", rms(found.errors)))
        print(line(f"{title}: second half (held out)", left))
        results.append((found, bool((left <= PANDA_BAR).all())))
    found, met = results[-1]
    print(line("armature found with links [kg m^2]", found.chain.arms["arm"].armature))
    for one in found.undetermined + found.notes:
        print("  " + one)
    print(f"bar {'met' if met else 'MISSED'}")
    return met


def gen3_motion(folder: Path) -> bool:
    """Gen3: an unknown tool and friction from every other fifth of 2.3 s, residuals of the torques in the others."""
    t, q, tau = columns(folder / "gen3_motion.csv", "t", "q", "tau_sensor")
    ready, report = prepared(Recording(t=t, q=q, tau=tau), cutoff=10.0)
    print(report)
    arm = gen3()
    bare = hf.ClosedChain({"arm": arm})
    guess = hf.HeldObject.box(0.5, 0.1, 0.1, 0.1)
    holding = hf.ClosedChain({"arm": arm}, guess, {"arm": hf.Grasp("rigid", hf.Pose.identity())})
    fifths = [between(ready, k / 10, (k + 1) / 10) for k in range(10)]
    first, second = fifths[::2], fifths[1::2]

    def held_out(found: hf.identification.Identification) -> np.ndarray:
        return np.concatenate([measurement_errors(found.chain, one, "tau", found.others) for one in second])

    print(line("rms torque [N m]", rms(np.asarray(ready.tau))))
    print(line("residual of the model as it is", rms(measurement_errors(bare, ready, "tau"))))
    friction = ("damping", "friction", "friction_offset")
    free = hf.identification.Prior(links=1.0)
    left, results = {}, {}
    for title, chain, kinds, prior in (
        ("tool", holding, ("payload",), None),
        ("tool and friction", holding, ("payload", *friction), None),
        ("all base parameters, friction, armature", bare, ("links", "armature", *friction), free),
    ):
        found = hf.identify(chain, first, by="tau", unknowns=kinds, prior=prior)
        left[title] = rms(held_out(found))
        print(line(f"{title}: fitted", rms(found.errors)))
        print(line(f"{title}: held out", left[title]))
        results[title] = found
    tool = results["tool and friction"]
    print("the tool's ten numbers:")
    for name, value in zip(tool.names[:10], tool.values[:10].tolist(), strict=True):
        said = "not determined" if name in tool.kept else "partly determined" if name in tool.partly else ""
        print(f"  {name:<12} {value:+9.4f} {said or f'+- {tool.deviations[name]:.2g}'}")
    for one in tool.undetermined + tool.notes:
        print("  " + one)
    limit = np.maximum(1.2, 1.2 * left["all base parameters, friction, armature"])
    print(line("bar for joints 2 .. 6", limit))
    met = bool((left["tool and friction"] <= limit)[1:6].all())
    print(f"bar {'met' if met else 'MISSED'}")
    return met


def two_ur5e(folder: Path) -> bool:
    """Two UR5e: tool positions, closure, and masses from the forces of both arms, by two runs; other runs predicted."""
    met = measured_calibration.main(folder)
    print(f"bars {'met' if met else 'MISSED'}")
    return met


EVERY = 4  # rows of the Panda's log, of which one is kept
PANDA_SOURCES = {"t": "time", "q": "positions", "qd": "velocity", "tau": "torques"}  # exciting_traj_*.txt
GEN3_SOURCES = {"q": "Position", "qd": "Velocity", "tau_sensor": "TorqueSm", "current": "Cur"}


def source_file(source: Path, name: str) -> Path:
    """Return the file of a name somewhere below a folder."""
    found = sorted(source.rglob(name))
    if not found:
        raise SystemExit(f"{source}: expected {name} in it, got none; docs/measured_robots.md says where to get it")
    return found[0]


def convert_panda(source: Path, folder: Path) -> Path:
    """Write the Panda's log: its files have one number a line, seven for each sample."""
    read = {key: np.loadtxt(source_file(source, f"exciting_traj_{name}.txt")) for key, name in PANDA_SOURCES.items()}
    samples = len(read["t"])
    for key, values in read.items():
        if key != "t" and values.size != 7 * samples:
            raise SystemExit(f"{PANDA_SOURCES[key]}: expected 7 numbers for each of {samples} times, got {values.size}")
    table = {"t": read.pop("t")} | {
        f"{key}{k + 1}": values.reshape(samples, 7)[:, k] for key, values in read.items() for k in range(7)
    }
    return written(folder / "panda_excitation.csv", {name: column[::EVERY] for name, column in table.items()})


def convert_gen3(source: Path, folder: Path) -> Path:
    """Write the Gen3's log: a table with times in ms, sensors' torques and currents beside others."""
    read = np.genfromtxt(source_file(source, "opti_traj_testing2.csv"), delimiter=",", names=True)
    needed = ["Time", *(f"{name}{k}" for name in GEN3_SOURCES.values() for k in range(1, 8))]
    if absent := [name for name in needed if name not in (read.dtype.names or ())]:
        raise SystemExit(f"opti_traj_testing2.csv: expected columns {', '.join(absent)}, got {read.dtype.names}")
    table = {"t": 1e-3 * read["Time"]} | {
        f"{key}{k}": read[f"{name}{k}"] for key, name in GEN3_SOURCES.items() for k in range(1, 8)
    }
    return written(folder / "gen3_motion.csv", table)


def written(path: Path, table: dict[str, np.ndarray]) -> Path:
    """Write columns as a file, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(list(table.values())), "%.9g", ",", header=",".join(table), comments="")
    return path


CONVERTED: dict[str, Callable[[Path, Path], Path]] = {"panda": convert_panda, "gen3": convert_gen3}
ROBOTS: dict[str, Callable[[Path], bool]] = {"panda": panda_excitation, "gen3": gen3_motion, "ur5e": two_ur5e}
LOGS = {"panda": "panda_excitation.csv", "gen3": "gen3_motion.csv", "ur5e": "dual_ur5e_*kg*.csv"}


def main() -> int:
    """Print the tables of the robots that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("robots", nargs="*", choices=[*ROBOTS, []], help="all by default")
    parser.add_argument(
        "--convert", type=Path, metavar="SOURCE", help="make the folder's files from those below SOURCE"
    )
    given = parser.parse_args()
    met = []
    for name in given.robots or ROBOTS:
        print(f"== {name}: {(ROBOTS[name].__doc__ or '').strip()}")
        if given.convert is not None and name in CONVERTED:
            print(f"made {CONVERTED[name](given.convert, given.folder)}")
        if not any(given.folder.glob(LOGS[name])):
            said = f"expected {LOGS[name]} in {given.folder}, got none; docs/measured_robots.md says where to get it"
            if given.robots:
                raise SystemExit(f"{name}: {said}")
            print(f"left out: {said}")
            continue
        met.append(ROBOTS[name](given.folder))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
