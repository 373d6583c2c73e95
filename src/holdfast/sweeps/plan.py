"""The plan of a sweep, which determines the initial state and parameters of every run."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from holdfast.control.controller import ControlLaw
from holdfast.control.sampled import has_noise, initial_memories, require_steps
from holdfast.control.traced_law import law_program
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.arguments import chain_arguments, number, step_options, whole_number, whole_steps
from holdfast.simulation.rollout.compile_rollout import compile_rollout
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.real_numbers import numbers
from holdfast.state import State
from holdfast.sweeps.distributions import ParameterDistribution, uniforms

OUTPUTS = ("object_pose", "object_twist", "grasp_wrench", "worst_margin")
MOST_RUNS = 10**12
LARGEST_CHUNK = 10**6
LARGEST_SEED = 2**63
END_ARRAYS = ("status", "stopped")  # columns that every sweep has
TRIED = 64  # number of first runs, one of which must start on its grasps


@dataclass(frozen=True, eq=False)
class Plan(Frozen):
    """The data that determine the results of a sweep, byte by byte.

    Attributes:
        rollout: the machine code of the steps.
        state: initial state of every run, except for arrays in `samples`.
        samples: by name, a distribution, an array for all runs, or a row for each; or "scale" for `object_inertia`.
        count: number of runs.
        chunk: number of runs that are computed together and stored in one file.
        seed: seed of the random draws.
        duration, step: duration and step h of the runs [s].
        outputs: names of attributes of `RolloutSystems` to store at the end.
        options: options of `Rollout.run`.
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
        """Number of chunks; the last one may be shorter."""
        return -(-self.count // self.chunk)

    def bounds(self, k: int) -> tuple[int, int]:
        """Return the numbers of the first run of chunk k and of the one after its last."""
        return k * self.chunk, min((k + 1) * self.chunk, self.count)

    def rows(self, begin: int, end: int) -> dict[str, Any]:
        """Return the arguments of `Rollout.start` for some runs.

        Arrays that differ between runs have one row per run, (end - begin, ...).

        Raises:
            StateError: a distribution does not fit its parameter.
        """
        shapes = sample_shapes(self.rollout)
        fields = state_fields(self.rollout.chain).items()
        found: dict[str, Any] = {name: getattr(self.state, at).reshape(shapes[name]) for name, at in fields}
        for name, sample in self.samples.items():
            shape = shapes[name]
            if isinstance(sample, ParameterDistribution):
                u = uniforms(self.seed, name, begin, end, sample.width(shape))
                found[name] = sample.values(name, shape, u)
            else:
                found[name] = sample[begin:end] if varies(sample, shape) else sample
        if has_noise(self.rollout.law):  # each run has its own
            found["memory"] = initial_memories(self.rollout.law, np.arange(begin, end))
        if found["q"].ndim == 1:  # the rows of the state determine the number of systems
            found["q"] = np.tile(found["q"], (end - begin, 1))
        return found

    def drawn(self) -> tuple[str, ...]:
        """Return the names of the arrays that differ between runs."""
        shapes = sample_shapes(self.rollout)
        return tuple(
            name for name, x in self.samples.items() if isinstance(x, ParameterDistribution) or varies(x, shapes[name])
        )

    def description(self) -> dict[str, Any]:
        """Return the description of the plan in the manifest; plans with the same description give the same bytes."""
        rollout = self.rollout
        program = law_program(rollout.law, rollout.chain)
        law = (program.input_shapes, program.instructions, program.outputs, rollout.law.memory.tolist())
        found = {
            "model_sha256": fingerprint(rollout.chain),
            "law_sha256": _sha256(repr(law)),
            "state_sha256": fingerprint(self.state),
            "samples": {name: _described(x) for name, x in self.samples.items()},
            **{name: getattr(self, name) for name in ("count", "chunk", "seed", "duration", "step")},
            "scheme": rollout.scheme,
            "options": dict(self.options),
            "outputs": list(self.outputs),
            **made_by(),
        }
        return json.loads(json.dumps(found), parse_constant=str)  # as JSON has it, infinities as text

    def settled(self, generic_rank: int) -> Plan:
        """Return the plan with the generic rank for all chunks."""
        old = self.rollout
        parts = (old.base_motion, old.options, old.inputs)
        return replace(self, rollout=Rollout(old.chain, old.law, old.scheme, generic_rank, *parts))


def plan_of(
    chain: ClosedChain,
    law: ControlLaw | None,
    *,
    state: State,
    parameters: Mapping[str, Any],
    count: int,
    duration: float,
    step: float,
    outputs: Sequence[str],
    seed: int,
    chunk: int,
    scheme: str,
    least_margin: float,
    stop_at_limits: bool,
    largest_drift: float | None,
) -> Plan:
    """Return the plan of a sweep; the arguments are those of `sweep`.

    Raises:
        StateError: an argument is invalid.
        ModelError, CompileError: as for `compile_rollout`.
    """
    rollout = compile_rollout(chain, law, scheme=scheme)
    if not isinstance(state, State):
        raise StateError(
            f"state: expected a State, got {type(state).__name__}; try what `close` or `assemble` returned"
        )
    if not isinstance(parameters, Mapping):
        raise StateError(f"parameters: expected a mapping of names, got {type(parameters).__name__}")
    options = step_options(least_margin, stop_at_limits, largest_drift)
    runs = whole_number("count", count, MOST_RUNS)
    length, h = number("duration", duration), number("step", step)
    if h <= 0.0:
        raise StateError(f"step: expected a positive number of seconds, got {checks.short(step)}")
    whole_steps(length, h)
    require_steps(rollout.law, h)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < LARGEST_SEED:
        raise StateError(f"seed: expected an integer >= 0, got {checks.short(seed)}")
    plan = Plan(
        rollout,
        state,
        parsed_samples(rollout, parameters, runs),
        runs,
        whole_number("chunk", chunk, LARGEST_CHUNK),
        seed,
        length,
        h,
        parsed_outputs(outputs),
        options,
    )
    plan.rows(0, 1)  # this raises the errors of unsuitable distributions
    return plan


@functools.cache
def made_by() -> Mapping[str, Any]:
    """Return the versions of libraries that affect the last bits of results, and the kind of the processor."""
    names = ("holdfast", "numpy", "scipy", "llvmlite", "pyarrow")
    return {"versions": {name: version(name) for name in names}, "processor": platform.machine()}


def digest_of(description: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest of a plan's description."""
    return _sha256(json.dumps(description, sort_keys=True))


def sample_shapes(rollout: Rollout) -> dict[str, tuple[int, ...]]:
    """Return the shapes of arrays that may differ between runs: parameters of law and chain, and the initial state."""
    chain, kernel = rollout.chain, rollout.kernel
    own = {"base_pose": (len(chain.arms), 7), "grasp_pose": (len(chain.grasps), 7)}
    shapes = {name: own[name] if name in own else kernel.externals[name].shape for name in chain_arguments(kernel)}
    return {**shapes, **{name: kernel.carried[name] for name in state_fields(chain)}, **kernel.law.parameters}


def varies(sample: Any, shape: tuple[int, ...]) -> bool:
    """Return whether a sample has a row for each run."""
    return isinstance(sample, np.ndarray) and sample.ndim > len(shape)


def parsed_samples(rollout: Rollout, given: Mapping[str, Any], count: int) -> dict[str, Any]:
    """Return samples by name, with numbers as arrays.

    Raises:
        StateError: a parameter is unknown, a parameter of the law is missing, or an array has a wrong shape or is not
            finite.
    """
    shapes, found = sample_shapes(rollout), {}
    for name, x in given.items():
        if name not in shapes:
            raise StateError(f"parameters: no parameter '{name}'.{checks.did_you_mean(name, shapes)}")
        if isinstance(x, ParameterDistribution) or (name == "object_inertia" and isinstance(x, str) and x == "scale"):
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
        StateError: a name is not that of an attribute of `RolloutSystems`, or is given twice.
    """
    known = [
        n for n, x in vars(RolloutSystems).items() if isinstance(x, property) and n not in (*END_ARRAYS, "running")
    ]
    if not isinstance(outputs, str) and not checks.is_listed(outputs):
        raise StateError(f"outputs: expected names of arrays, got {checks.short(outputs)}")
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    for name in names:
        if name not in known:
            raise StateError(f"outputs: no array {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
    if len(set(names)) < len(names):
        raise StateError(f"outputs: expected every name once, got {', '.join(names)}")
    return names


def find_generic_rank(plan: Plan) -> int:
    """Return the generic rank of the grasp constraint, which is found once for all chunks.

    Raises:
        StateError: none of the first runs starts on its grasps, or their parameters are refused.
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
    if isinstance(x, ParameterDistribution):
        return {type(x).__name__: {name: np.asarray(value).tolist() for name, value in vars(x).items()}}
    if isinstance(x, np.ndarray) and x.size > 1000:
        return {"shape": list(x.shape), "sha256": hashlib.sha256(np.ascontiguousarray(x).tobytes()).hexdigest()}
    return x.tolist() if isinstance(x, np.ndarray) else x


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
