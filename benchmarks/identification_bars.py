"""Errors of whole-machine identification against their bounds: what it says that it knows, and how well it does.

    python -m benchmarks.identification_bars [--seeds 100] [--motions 1000] [--rate 1000]

Two Pandas hold a box for 10 s, along the D-optimal motion within the limits of their joints (`next_motion`).
Torques have 5 % of white noise, or noise of the same size that is half white and half slow. Estimated are payload,
armature, damping, friction and offsets of all joints, from a guess of the box that is far off. Printed are the errors,
relative to the Cramer-Rao bound of the same motion, the sizes that the bars limit, and how many of the 90 % regions
hold the truth. A rate below 1 kHz stands for as many averages of neighbouring samples, with less noise, for speed.

Beside it stands how many regions hold the truth, in the same noise, that are right: those of a linear fit about the
truth, with weights for white noise of the true size and the true covariance of its error. They hold 90 % of all truths,
so that what they hold more or less of these is luck; it is taken from the count before that meets its bar.

Then one Panda with the box makes random poor motions: short, slow, of few joints, or none. Counted are values that are
said to be known and are not: those that are off by more than five deviations.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import f as fisher
from tests.identification.recorded import BOX, shared, two_pandas

import holdfast as hf
from holdfast.dynamics import inertial_parameters
from holdfast.identification import Prior, Recording, next_motion
from holdfast.identification.machine.fit import machine_fit
from holdfast.identification.machine.identify_machine import Machine, machine_of
from holdfast.identification.machine.log_cholesky import coordinates_of
from holdfast.identification.machine.unknowns import MachineUnknowns, machine_unknowns
from holdfast.identification.rows import RecordedRows, rows_of
from holdfast.robots import HOME, panda
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.simulation.joint_friction import friction_torque

KINDS = ("payload", "armature", "damping", "friction", "friction_offset")
COULOMB = np.array([0.27, 0.44, 0.32, 0.64, 0.42, 0.3, 0.28])  # N m, half of the published steps of a Panda
DAMPING = np.array([1.0, 1.5, 1.0, 1.2, 0.6, 0.5, 0.4])  # N m s/rad
OFFSET = np.array([0.2, -0.3, 0.1, 0.2, -0.1, 0.05, 0.0])  # N m
GUESS = hf.HeldObject.box(1.5, 0.2, 0.2, 0.2)
NOISE, DURATION, FULL_RATE = 0.05, 10.0, 1000.0
CANDIDATES, PARTS = 60, 5  # parts of motions that are tried, and chosen
LEVEL, WITHIN = 0.9, (0.85, 0.95)
MEMORY = 0.95  # of slow noise, by which it depends on the sample before at full rate: 20 ms
SURE = 5.0


@dataclass(frozen=True)
class Truth:
    """What the joints really have, for arms one after the other."""

    arms: int

    def of(self, kind: str) -> np.ndarray:
        """Return the values of a kind."""
        values = {"armature": FR3_ARMATURE, "damping": DAMPING, "friction": COULOMB, "friction_offset": OFFSET}
        return np.tile(values[kind], self.arms)

    def torques(self, given: Recording) -> np.ndarray:
        """Return the torques of drives and friction."""
        assert given.qd is not None and given.qdd is not None
        rubbing = np.array([friction_torque(self.of("friction"), v) for v in given.qd])
        return self.of("armature") * given.qdd + self.of("damping") * given.qd + rubbing + self.of("friction_offset")

    def coordinates(self, unknowns: MachineUnknowns, box: hf.HeldObject = BOX) -> np.ndarray:
        """Return the coordinates z of the truth."""
        z = unknowns.start.copy()
        for kind in unknowns.kinds:
            z[unknowns.where(kind)] = (
                coordinates_of(unknowns.roots[0], inertial_parameters(box)) if kind == "payload" else self.of(kind)
            )
        return z


def equations_of(chain: hf.ClosedChain, given: Recording) -> tuple[RecordedRows, MachineUnknowns]:
    """Return rows and unknowns of a model that has the guess of the box and no friction."""
    assert given.tau is not None
    model = replace(chain, held_object=GUESS)
    unknowns = machine_unknowns(model, "tau", KINDS, Prior(), given.tau, np.ones(chain.joint_count), DURATION)
    return rows_of(model, [given], unknowns), unknowns


def telling(chain: hf.ClosedChain, state: hf.State, rate: float) -> Recording:
    """Return the D-optimal motion of the arms with the guess of the box, with what the box itself needs as torques."""
    model = replace(chain, held_object=GUESS)
    given = next_motion(model, state, KINDS, duration=DURATION, rate=rate, tries=CANDIDATES, parts=PARTS)
    return replace(given, tau=np.array([squeezed(chain, given, k) for k in range(len(given))]))


def squeezed(chain: hf.ClosedChain, given: Recording, k: int) -> np.ndarray:
    """Return the torques of a sample, with a squeeze of the box."""
    assert given.qdd is not None and given.object_acceleration is not None
    state, tips = given.state(k), {}
    for name, grasp in chain.grasps.items():
        pose = hf.dynamics.tip_pose(chain.arms[name], state.q[chain.joints[name]])
        tips[name] = (pose.R, state.object_frame.R @ grasp.frame.p)
    f = shared(chain, state.object_frame, state.object_twist[:3], given.object_acceleration[k], tips)
    return hf.inverse_dynamics(chain, state, given.qdd[k], f)


def noise_of(kind: str, samples: int, sizes: np.ndarray, average: int, random: np.random.Generator) -> np.ndarray:
    """Return noise of every channel, (samples, channels), averaged over neighbours."""
    white = random.normal(size=(samples * average, len(sizes)))
    if kind == "coloured":  # half of the variance is slow, with 20 ms of memory
        a = MEMORY
        pushes = random.normal(size=(samples * average + 500, len(sizes)))
        slow = lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], pushes, axis=0)
        white = np.sqrt(0.5) * (white + slow[500:])
    return sizes * white.reshape(samples, average, -1).mean(axis=1)


def synthetic(seeds: int, rate: float) -> bool:
    """Print errors, bounds and coverage on the most telling motion; return whether the bars are met."""
    chain, state = two_pandas()
    truth, started = Truth(2), time.perf_counter()
    given = telling(chain, state, rate)
    assert given.tau is not None
    print(f"{PARTS} of {CANDIDATES} parts of a motion chosen in {time.perf_counter() - started:.0f} s", flush=True)
    given = replace(given, tau=given.tau + truth.torques(given))
    rows, unknowns = equations_of(chain, given)
    print(f"{len(rows.b)} samples, equations in {time.perf_counter() - started:.0f} s", flush=True)
    average = round(FULL_RATE / rate)
    sizes = NOISE * np.sqrt((rows.y**2).mean(axis=0))
    z = truth.coordinates(unknowns)
    right, slope = unknowns.plain(z)
    line = Line.about(rows, unknowns, z, sizes, average)
    bound = np.sqrt(np.diag(slope @ np.linalg.inv(line.information) @ slope.T))
    show_bounds(rows, unknowns, line.information, bound, right, sizes / np.sqrt(average))
    groups = {
        "mass": np.array([0]),
        "com": np.arange(1, 4),
        "inertia": np.arange(4, 10),
        "friction": np.flatnonzero(np.isin(unknowns.kind_of, ("damping", "friction"))),
        "armature": unknowns.where("armature"),
    }
    met = True
    for kind in ("white", "coloured"):
        found: list[Machine] = []
        others, true = [], slope @ line.covariance(kind) @ slope.T
        for seed in range(seeds):
            noise = noise_of(kind, len(rows.y), sizes, average, np.random.default_rng(seed))
            noisy = replace(rows, y=rows.y + noise)
            fit = machine_fit(noisy, unknowns, np.arange(chain.joint_count), None, huber=False)
            found.append(machine_of(chain, unknowns, noisy, fit, 0.3))
            others.append(slope @ line.error(noise / sizes))
        errors = np.array([one.values for one in found]) - right
        rms = np.sqrt((errors**2).mean(axis=0))
        print(f"-- {kind} noise, {seeds} seeds, {time.perf_counter() - started:.0f} s")
        print(f"{'':10} rms error / bound   90 % regions, right ones   90 % intervals, right ones   largest rms error")
        for name, of in groups.items():
            ratio = float(np.sqrt((errors[:, of] ** 2 / bound[of] ** 2).mean()))
            hits = [
                held(errors[k], one.covariance, of, one.fit.freedoms) + held(others[k], true, of, np.inf)
                for k, one in enumerate(found)
            ]
            region, interval, best, each = 100 * np.mean(hits, axis=0)
            size = relative(name, rms[of], right[of])
            if name == "friction":
                size += f"; of its torque {100 * rubbed(given, errors, unknowns):.2f} %"
                size += f" ({unknowns.names[of[int(np.argmax(rms[of] / np.abs(right[of])))]]})"
            shares = f"{region:10.1f} % {best:8.1f} %   {interval:12.1f} % {each:8.1f} %"
            print(f"{name:10} {ratio:17.3f}   {shares}   {size}")
            met &= name == "inertia" or kind != "white" or ratio <= 1.15
            without_luck = np.array([region - best, interval - each]) / 100 + LEVEL
            met &= bool(((without_luck >= WITHIN[0]) & (without_luck <= WITHIN[1])).all())
        if kind == "white":
            mass, com = 100 * rms[0] / right[0], 1e3 * rms[1:4].max()
            met &= bool(mass <= 0.5) and bool(com <= 2.0)
            met &= rubbed(given, errors, unknowns) <= 0.03
            met &= bool((rms[groups["armature"]] <= 0.05 * right[groups["armature"]]).all())
    print(f"bars {'met' if met else 'MISSED'}", flush=True)
    return met


@dataclass(frozen=True)
class Line:
    """A linear least-squares fit about the truth, whose weights are those of white noise, by textbook equations.

    Attributes:
        information: (p, p) F of averages of white noise.
        influence: (samples, channels, p) minus F^-1 times these are errors of unit noise of full rate.
        average: samples of full rate that one of the equations is an average of.
    """

    information: np.ndarray
    influence: np.ndarray
    average: int

    @staticmethod
    def about(rows: RecordedRows, unknowns: MachineUnknowns, z: np.ndarray, sizes: np.ndarray, average: int) -> Line:
        """Return the fit of rows, about coordinates z, for noise of a size at full rate."""
        L = np.linalg.cholesky((rows.P * sizes**2) @ rows.P.transpose(0, 2, 1) / average)
        J, P = np.linalg.solve(L, rows.A @ unknowns.x(z)[1]), np.linalg.solve(L, rows.P * sizes)
        return Line(np.einsum("srj,srk->jk", J, J), P.transpose(0, 2, 1) @ J, average)

    def error(self, noise: np.ndarray) -> np.ndarray:
        """Return the error of the coordinates for averaged noise in units of its size at full rate."""
        return np.linalg.solve(self.information, np.einsum("scj,sc->j", self.influence, noise))

    def covariance(self, kind: str) -> np.ndarray:
        """Return the covariance of the error for a kind of noise; see `noise_of`."""
        M, a = np.zeros_like(self.information), MEMORY
        for of_channel in np.moveaxis(self.influence, 1, 0):
            B = np.repeat(of_channel, self.average, axis=0) / self.average
            white = B.T @ B
            if kind == "coloured":
                slow = np.asarray(lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], B[::-1], axis=0))
                before = a / np.sqrt(1.0 - a * a) * slow[-1]  # of what was pushed before the first sample
                white = 0.5 * (white + slow.T @ slow + np.outer(before, before))
            M += white
        inverse = np.linalg.inv(self.information)
        return inverse @ M @ inverse


def held(error: np.ndarray, covariance: np.ndarray, of: np.ndarray, freedoms: float) -> list[float]:
    """Return whether the region of some values holds the truth, and the share of their intervals that do."""
    e, C = error[of], covariance[np.ix_(of, of)]
    region = float(e @ np.linalg.solve(C, e)) < limit(len(of), freedoms)
    return [float(region), float(np.mean(e**2 < chi2.ppf(LEVEL, 1) * np.diag(C)))]


def limit(dimensions: int, freedoms: float) -> float:
    """Return the square of the radius of a region, in deviations that were found with some freedoms."""
    if np.isinf(freedoms):
        return float(chi2.ppf(LEVEL, dimensions))
    return dimensions * float(fisher.ppf(LEVEL, dimensions, freedoms))


def show_bounds(
    rows: RecordedRows,
    unknowns: MachineUnknowns,
    F: np.ndarray,
    bound: np.ndarray,
    right: np.ndarray,
    noise: np.ndarray,
) -> None:
    """Print the Cramer-Rao bounds of single coefficients of damping and dry friction, in percent.

    The second bound is that of a coefficient which is the only unknown; the third is the mean of all noise of the
    joint, which no motion with these torques goes below.
    """
    print(f"{'bounds [%]':26} damping   friction   if it alone were unknown   if its joint always slid, alone")
    damping, friction = unknowns.where("damping"), unknowns.where("friction")
    alone, mean = 1.0 / np.sqrt(np.diag(F)), noise / np.sqrt(len(rows.y))
    for k, (d, f) in enumerate(zip(damping, friction, strict=True)):
        shares = 100 * np.array([bound[d] / right[d], *(np.array([bound[f], alone[f], mean[k]]) / right[f])])
        name = unknowns.names[f].removesuffix(" friction")
        print(f"{name:26} {shares[0]:7.2f} {shares[1]:10.2f} {shares[2]:26.2f} {shares[3]:33.2f}", flush=True)


def rubbed(given: Recording, errors: np.ndarray, unknowns: MachineUnknowns) -> float:
    """Return the error of the torque of damping and friction, of the worst joint, relative to that torque (rms)."""
    assert given.qd is not None
    arms, dry = Truth(2), np.array([friction_torque(np.ones(14), v) for v in given.qd])
    of = {"damping": given.qd, "friction": dry}
    right = sum(arms.of(kind) * x for kind, x in of.items())
    off = [sum(error[unknowns.where(kind)] * x for kind, x in of.items()) for error in errors]
    return float((np.sqrt((np.square(off)).mean(axis=(0, 1))) / np.sqrt(np.square(right).mean(axis=0))).max())


def relative(name: str, rms: np.ndarray, right: np.ndarray) -> str:
    """Return the largest error of a group in the unit of its bar."""
    if name == "com":
        return f"{1e3 * rms.max():.3f} mm"
    if name == "inertia":
        return f"{rms.max():.2g} kg m^2"
    return f"{100 * (rms / np.abs(right)).max():.2f} %"


def poor_motions(count: int) -> bool:
    """Count false claims of random poor motions of one arm."""
    arm = panda()
    chain = hf.ClosedChain({"arm": arm}, BOX, {"arm": hf.Grasp("rigid", hf.Pose.translation(0.0, 0.0, 0.1))})
    model, truth = replace(chain, held_object=GUESS), Truth(1)
    claims = false = 0
    started = time.perf_counter()
    for seed in range(count):
        random = np.random.default_rng(seed)
        moving = random.random(7) < random.uniform(0.0, 0.6)
        size, f = random.uniform(0.0, 0.3, 7) * moving, 2.0 * np.pi * 10.0 ** random.uniform(-2.0, 0.0, 7)
        samples = int(random.integers(12, 40))
        t = np.linspace(0.0, random.uniform(0.2, 5.0), samples)
        x = f * t[:, None] + random.uniform(0.0, 2.0 * np.pi, 7)
        q = HOME["panda"] + random.uniform(-0.3, 0.3, 7) + size * np.sin(x)
        given = Recording(t=t, q=q, qd=size * f * np.cos(x), qdd=-size * f**2 * np.sin(x), tau=0.0 * q)
        kinds = [kind for kind in KINDS if random.random() < 0.7] or ["payload"]
        kinds += ["links"] if random.random() < 0.3 else []
        tau = truth.torques(given) - hf.identification.measurement_errors(chain, given, "tau")
        tau = tau if "friction_offset" in kinds else tau - OFFSET
        level = NOISE * np.maximum(np.sqrt((tau**2).mean(axis=0)), 0.1)
        whole = replace(given, tau=tau + level * random.normal(size=q.shape))
        found = hf.identify(rubbing(model, truth, kinds), whole, by="tau", unknowns=kinds)
        right = right_values(chain, truth, found.names)
        for name, value in zip(found.names, found.values.tolist(), strict=True):
            deviation = found.deviations[name]
            if np.isfinite(deviation):
                claims += 1
                if abs(value - right[name]) > SURE * deviation:
                    false += 1
                    print(f"  seed {seed}: {name} {value:.4g} +- {deviation:.2g}, but it is {right[name]:.4g}")
        if (seed + 1) % 100 == 0 or seed + 1 == count:
            done = f"{seed + 1} poor motions, {time.perf_counter() - started:.0f} s"
            print(f"{done}: {claims} values said to be known, {false} of them wrongly", flush=True)
    return not false


def rubbing(model: hf.ClosedChain, truth: Truth, kinds: list[str]) -> hf.ClosedChain:
    """Return the model with the true values of what is not asked for."""
    known = [kind for kind in ("armature", "damping", "friction") if kind not in kinds]
    joints = [
        replace(joint, **{kind: float(truth.of(kind)[k]) for kind in known})
        for k, joint in enumerate(model.arms["arm"].joints)
    ]
    held = model.held_object if "payload" in kinds else BOX
    return replace(model, arms={"arm": replace(model.arms["arm"], joints=joints)}, held_object=held)


def right_values(chain: hf.ClosedChain, truth: Truth, names: tuple[str, ...]) -> dict[str, float]:
    """Return the true values by name."""
    entries = np.triu_indices(3)
    box = [BOX.mass, *BOX.com, *BOX.inertia[entries]]
    found = dict(zip(names[:10], box, strict=True)) if names[0] == "mass" else {}
    for joint, title in enumerate(chain.joint_names()):
        for kind in KINDS[1:]:
            found[f"{title} {kind.replace('_', ' ')}"] = truth.of(kind)[joint]
    for link in chain.arms["arm"].links:
        titles = [name for name in names if name.startswith(f"arm/{link.name} ")]
        found |= dict(zip(titles, [link.mass, *link.com, *link.inertia[entries]], strict=False))
    return found


def main() -> int:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--motions", type=int, default=1000)
    parser.add_argument("--rate", type=float, default=FULL_RATE, help="samples a second [Hz]")
    given = parser.parse_args()
    met = [synthetic(given.seeds, given.rate)] if given.seeds else []
    met += [poor_motions(given.motions)] if given.motions else []
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
