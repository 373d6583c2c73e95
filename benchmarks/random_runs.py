"""Random runs of `simulate` of every kind, each a pure function of its seed, for comparing versions of the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from benchmarks.random_families import FAMILIES, Scene
from benchmarks.random_laws import Random, random_inputs, random_law

ROUNDING = 1e-15  # rad or m, and their rates


class Run(NamedTuple):
    """A run that can be made.

    Attributes:
        family: name of its family.
        options: what was drawn, in words.
        tolerance: absolute plus relative tolerance of an adaptive scheme; 0 for fixed steps.
        make: makes it.
    """

    family: str
    options: str
    tolerance: float
    make: Callable[[], hf.simulation.Trajectory]


def drawn(random: Random, scene: Scene) -> tuple[dict[str, Any], list[str]]:
    """Return the arguments of `simulate` that a scene leaves open, and words for them."""
    fixed = scene.given.get("scheme")
    scheme = fixed or str(random.choice(["rk4", "midpoint", "imex", "dop853"], p=[0.5, 0.15, 0.15, 0.2]))
    step = float(np.exp(random.uniform(*np.log(scene.step))))
    steps = 20.0 * 5.0 ** random.random()  # 20 to 100
    duration = scene.given.get("duration", step * (np.ceil(steps) if random.random() < 0.7 else steps))
    options: dict[str, Any] = {"scheme": scheme, "duration": duration, "step": min(step, duration)}
    words = [scheme]
    if scheme == "dop853":
        options["rtol"] = float(random.choice([1e-6, 1e-8, 1e-10]))
        options["step"] = duration / random.uniform(3.0, 10.0)
    elif random.random() < 0.15:
        options["largest_drift"] = float(10 ** random.uniform(-12.0, -8.0))
    if random.random() < 0.3:
        options["sample_time"] = options["step"] * float(random.choice([0.7, 1.0, 1.0, 2.0, 3.3]))
        options["delay"] = options["sample_time"] * float(random.choice([0.0, 0.0, 0.4, 1.0, 2.0]))
        words.append("sampled" if not options["delay"] else "delayed")
    if random.random() < 0.15:
        options["breakpoints"] = (duration * random.uniform(-0.1, 1.1, 2)).tolist()
    options["on_slip"] = str(random.choice(["stop", "record", "release"]))
    options["on_limit"] = str(random.choice(["record", "stop", "clip"], p=[0.5, 0.2, 0.3]))
    options["on_singular"] = str(random.choice(["stop", "continue"]))
    kind, options["inputs"] = random_inputs(random, scene.chain)
    words += [] if "inputs" in scene.given or kind == "none" else [f"wrenches {kind}"]
    name, law, parameters = random_law(random, scene.chain, scene.state, scene.push, duration, scene.laws)
    if "controller" not in scene.given:
        options |= {"controller": law} if parameters is None else {"controller": law, "parameters": parameters}
        words.append(name)
    return options, words


def random_run(seed: int, nudge: int = 0) -> Run:
    """Return the run of a seed.

    Args:
        seed: of its random numbers.
        nudge: if not 0, the seed of a change of the state by rounding errors.
    """
    family, random = list(FAMILIES)[seed % len(FAMILIES)], np.random.default_rng([39, seed])
    scene = FAMILIES[family](random)
    options, words = drawn(random, scene)
    options |= scene.given
    state = options.pop("state", scene.state)
    if nudge:
        by_q, by_qd = ROUNDING * np.random.default_rng([40, seed, nudge]).normal(size=(2, len(state.q)))
        state = replace(state, q=state.q + by_q, qd=state.qd + by_qd)
    words += [f"{name}={options[name]}" for name in ("on_slip", "on_limit", "on_singular")]
    rtol = options["rtol"] if options["scheme"] == "dop853" and "rtol" in options else 0.0
    run = partial(hf.simulate, scene.chain, state, **options)
    place = float(random.uniform(0.1, 0.8))
    return Run(family, ", ".join(words), 2.0 * rtol, partial(_continued, run, place) if scene.continued else run)


def _continued(run: Callable[..., hf.simulation.Trajectory], place: float) -> hf.simulation.Trajectory:
    """Return the rest of a run from one of its checkpoints, at this fraction of them."""
    left: list[Any] = []
    whole = run(on_checkpoint=left.append)
    return run(start=left[int(place * len(left))]) if left else whole
