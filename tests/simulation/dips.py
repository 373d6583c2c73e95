"""A contact whose margin dips below zero at chosen times, for chosen whiles, in chosen shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.simulation.simulate import simulate
from holdfast.simulation.trajectory import Trajectory
from tests.simulation.gantries import pressed

SHAPES = ("parabola", "bell", "triangle", "box", "sawtooth")


@dataclass(frozen=True)
class Dips:
    """A torque that is negative in each of some intervals, and positive elsewhere.

    Attributes:
        begins: (k,) [s].
        widths: (k,) [s].
        shapes: (k,) of `SHAPES`.
    """

    begins: np.ndarray
    widths: np.ndarray
    shapes: tuple[str, ...]

    @classmethod
    def random(cls, count, step, least, most, seed):
        """Return dips of `least` to `most` steps (evenly spread in their logarithm) at random phase."""
        rng = np.random.default_rng(seed)
        widths = step * np.exp(rng.uniform(np.log(least), np.log(most), count))
        gaps = step * rng.uniform(0.5, 1.0, count)
        begins = np.cumsum(gaps) + np.r_[0.0, np.cumsum(widths)[:-1]]
        return cls(begins, widths, tuple(rng.choice(SHAPES, count)))

    @property
    def duration(self):
        """When all is over [s]."""
        return float(self.begins[-1] + self.widths[-1]) * 1.001 + 1e-3

    def torque(self, t):
        """Return the torque: beside every dip its shape goes on to a positive value, 1 at most."""
        middles = 0.5 * (self.begins[1:] + self.begins[:-1] + self.widths[:-1])
        k = int(np.searchsorted(middles, t))
        return min(1.0, _shape(self.shapes[k], (t - self.begins[k]) / self.widths[k]))


def _shape(name, x):
    """Return a function that is negative for 0 < x < 1 and positive outside."""
    if name == "parabola":
        return 4 * x * (x - 1)
    if name == "bell":  # 1 - a exp(-..), zero at 0 and 1
        return 1 - 3.0 ** (1 - (2 * x - 1) ** 2)
    if name == "triangle":
        return 2 * abs(x - 0.5) - 1
    if name == "box":
        return -0.7 if 0 < x < 1 else 1.0
    return -x if 0 < x < 1 else 0.5 + abs(x)


def found_dips(dips: Dips, step: float, of=None, law=lambda function: function, **options) -> Trajectory:
    """Return the run, having asserted that every dip is found, its ends to 1e-9 s, and nothing else is.

    Args:
        dips: the dips of the torque.
        step: [s].
        of: the chain and its state; None for `pressed`.
        law: makes a controller of the torques as a function; `ControlLaw` where functions are called at stages only.
        **options: of `simulate`.
    """
    chain, state = of or pressed()
    acting = law(lambda t, s, m, given=None: (np.array([dips.torque(t)]), m))
    run = simulate(chain, state, acting, dips.duration, step, on_slip="record", **options)
    assert run.stopped is None
    found = [one for one in run.occurrences if one.kind != "unresolved"]  # torques jump inside steps
    assert [one.kind for one in found] == len(dips.begins) * ["violation", "recovery"]
    begins, ends = (np.array([one.t for one in found[k::2]]) for k in (0, 1))
    assert np.abs(begins - dips.begins).max() <= 1e-9
    assert np.abs(ends - dips.begins - dips.widths).max() <= 1e-9
    return run
