"""The plan of a sweep: which run begins how, whoever computes it and in whatever order."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from holdfast.compiled.externals import state_fields
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.rollout.arguments import CHAINS, whole_number
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.user_functions import law_program
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.real_numbers import numbers
from holdfast.state import State
from holdfast.sweeps.distributions import Distribution, uniforms

MOST_RUNS = 10**12
OWN = ("status", "stopped")  # columns that every sweep has
TRIED = 64  # runs among which one must begin on its grasps


@dataclass(frozen=True, eq=False)
class Plan(Frozen):
    """All that decides a byte of the results.

    Attributes:
        rollout: the machine code of the steps.
        state: that every run begins at, but for what `samples` has of it.
        samples: by name, a distribution, numbers for all runs or a row for each; "scale" of `object_inertia`.
        count: how many runs.
        chunk: how many of them are one piece of work and one file.
        seed: of the draws.
        duration, step: [s].
        outputs: attributes of `RolloutSystems`, at the end.
        options: of `Rollout.run`.
    """

    rollout: Rollout
    state: State
    samples: Mapping[str, Any]
    count: int
    chunk: int
    seed: int
    duration: float
    step: float
    outputs: tuple[str, ...]
    options: Mapping[str, Any]

    @property
    def chunk_count(self) -> int:
        """How many chunks there are; the last may be shorter."""
        return -(-self.count // self.chunk)

    def bounds(self, k: int) -> tuple[int, int]:
        """Return the first run of chunk k and the one after its last."""
        return k * self.chunk, min((k + 1) * self.chunk, self.count)

    def rows(self, begin: int, end: int) -> dict[str, Any]:
        """Return the arguments of `Rollout.start` for some runs.

        A row each, (end - begin, ...), of what differs from run to run.

        Raises:
            StateError: a distribution that does not fit its parameter.
        """
        shapes = sample_shapes(self.rollout)
        found: dict[str, Any] = {name: getattr(self.state, at) for name, at in state_fields(self.rollout.chain).items()}
        for name, sample in self.samples.items():
            shape = shapes[name]
            if isinstance(sample, Distribution):
                u = uniforms(self.seed, name, begin, end, sample.width(shape))
                found[name] = sample.values(name, shape, u)
            else:
                found[name] = sample[begin:end] if varies(sample, shape) else sample
        if found["q"].ndim == 1:  # a state's rows say how many systems there are
            found["q"] = np.tile(found["q"], (end - begin, 1))
        return found

    def drawn(self) -> tuple[str, ...]:
        """Return the names of what differs from run to run."""
        shapes = sample_shapes(self.rollout)
        return tuple(name for name, x in self.samples.items() if isinstance(x, Distribution) or varies(x, shapes[name]))

    def description(self) -> dict[str, Any]:
        """Return what the manifest says of the plan; two plans with the same description give the same bytes."""
        rollout = self.rollout
        program = law_program(rollout.law, rollout.chain)
        law = (program.input_shapes, program.instructions, program.outputs, rollout.law.memory.tolist())
        return {
            "model_sha256": fingerprint(rollout.chain),
            "law_sha256": _sha256(repr(law)),
            "state_sha256": fingerprint(self.state),
            "samples": {name: _described(x) for name, x in self.samples.items()},
            "count": self.count,
            "chunk": self.chunk,
            "seed": self.seed,
            "duration": self.duration,
            "step": self.step,
            "scheme": rollout.scheme,
            "options": dict(self.options),
            "outputs": list(self.outputs),
            "versions": {name: version(name) for name in ("holdfast", "numpy", "scipy", "llvmlite", "pyarrow")},
            "processor": platform.machine(),
        }


def digest_of(description: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a plan's description."""
    return _sha256(json.dumps(description, sort_keys=True))


def sample_shapes(rollout: Rollout) -> dict[str, tuple[int, ...]]:
    """Return what may differ from run to run: the law's parameters, the chain's, the state at the start."""
    chain, kernel = rollout.chain, rollout.kernel
    own = {"base_pose": (len(chain.arms), 7), "grasp_pose": (len(chain.grasps), 7)}
    shapes = {name: own[name] if name in own else kernel.externals[name].shape for name in CHAINS}
    return {**shapes, **{name: kernel.carried[name] for name in state_fields(chain)}, **kernel.law.parameters}


def varies(sample: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a sample has a row for each run."""
    return isinstance(sample, np.ndarray) and sample.ndim > len(shape)


def parsed_samples(rollout: Rollout, given: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Return samples by name, numbers as arrays.

    Raises:
        StateError: no such parameter, one of the law is missing, numbers of another shape or not finite.
    """
    shapes, found = sample_shapes(rollout), {}
    for name, x in given.items():
        if name not in shapes:
            raise StateError(f"parameters: no parameter '{name}'.{checks.did_you_mean(name, shapes)}")
        if isinstance(x, Distribution) or (name == "object_inertia" and isinstance(x, str) and x == "scale"):
            found[name] = x
            continue
        array, shape = numbers(x, None, name, StateError), shapes[name]
        if array.shape not in (shape, (count, *shape)):
            raise StateError(
                f"{name}: expected a distribution, or numbers of shape {shape} or ({count}, *{shape}), got shape"
                f" {array.shape}"
            )
        found[name] = array
    if missing := [name for name in rollout.law.parameters if name not in found]:
        raise StateError(
            f"parameters: the control law's '{missing[0]}' is missing: expected shape {shapes[missing[0]]}"
        )
    return found


def parsed_outputs(outputs: Any) -> tuple[str, ...]:
    """Return the names of outputs.

    Raises:
        StateError: no such attribute of `RolloutSystems`, or one named twice.
    """
    known = [n for n, x in vars(RolloutSystems).items() if isinstance(x, property) and n not in (*OWN, "running")]
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    for name in names:
        if name not in known:
            raise StateError(f"outputs: no array '{name}'.{checks.did_you_mean(str(name), known)}")
    if len(set(names)) < len(names):
        raise StateError(f"outputs: expected every name once, got {', '.join(names)}")
    return names


def bounded(name: str, value: Any, most: int = MOST_RUNS) -> int:
    """Return an integer from 1 to a bound.

    Raises:
        StateError: it is none.
    """
    x = whole_number(name, value)
    if x > most:
        raise StateError(f"{name}: expected at most {most}, got {x}")
    return x


def find_generic_rank(plan: Plan) -> int:
    """Return the rank of the grasp constraint in general, found once so that no chunk finds its own.

    Raises:
        StateError: none of the first runs begins on its grasps, or their parameters are refused.
    """
    tried = min(TRIED, plan.count)
    plan.rollout.start(**plan.rows(0, tried))
    if plan.rollout.generic_rank is None:
        raise StateError(
            f"sweep: expected runs that begin with their grasps nearly closed, got none among the first {tried}; try a"
            " state that `close` or `assemble` returned, and smaller changes of it"
        )
    return plan.rollout.generic_rank


def _described(x: Any) -> Any:
    if isinstance(x, Distribution):
        return {type(x).__name__: {name: np.asarray(value).tolist() for name, value in vars(x).items()}}
    if isinstance(x, np.ndarray) and x.size > 1000:
        return {"shape": list(x.shape), "sha256": hashlib.sha256(np.ascontiguousarray(x).tobytes()).hexdigest()}
    return x.tolist() if isinstance(x, np.ndarray) else x


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
