"""The structure of a chain: which of its numbers become constants of the machine code, and which are parameters."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.dynamics.closed.tip_response import Route
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import code_key, digest_of, fingerprint
from holdfast.model.forest import Forest
from holdfast.model.grasp import WrenchLimits
from holdfast.model.grasp_kinds import GraspKind

MOST_SOLVER_ITERATIONS = 100
OPTIONAL = ("link_inertia", "link_wrench")  # run-time parameters that exist only on request


@dataclass(frozen=True)
class Options:
    """The options on which machine code depends.

    Attributes:
        route: how the inverse inertia at each arm's tip is computed.
        link_inertia: whether masses, mass centres and inertias of links are run-time parameters.
        link_wrenches: whether external wrenches on the links are an input.
        base_motion: whether twists and accelerations of the bases are run-time parameters; otherwise they are zero.
        held: whether steps hold as many rows of the constraint as its generic rank (see `held_rows`).
        implicit: whether additional joint armatures and torques are inputs, for the stages of implicit steps.
        resolution: whether steps notice that they may not follow the motion (`simulation.resolution`).
        adaptive: whether steps estimate their error and compare it with a tolerance, an input.
        stages: number of stages of a step with given values (`rollout.stage_values`); 0 if a law computes torques.
        contacts: how steps find impulses of contacts with the world, see `rollout.traced_impulses`, or that contacts
            keep their modes, see `rollout.traced_modes`; "" without any.
        further: names of further run-time parameters, of the questions that have them as `optional`.
        iterations: number of iterations of questions that are `iterative`; None for each one's own.
    """

    route: Route = "auto"
    link_inertia: bool = False
    link_wrenches: bool = False
    base_motion: bool = False
    held: bool = False
    implicit: bool = False
    resolution: bool = False
    adaptive: bool = False
    stages: int = 0
    contacts: str = ""
    further: tuple[str, ...] = ()
    iterations: int | None = None


def require_rank(generic_rank: Any, chain: ClosedChain | Forest, what: str) -> None:
    """Refuse what is no rank of a chain's grasp constraint.

    Raises:
        StateError: naming what could be one.
    """
    if not _whole_or_none(generic_rank, 0, chain.constraint_row_count):
        raise StateError(
            f"{what}: generic_rank: expected an integer from 0 to {chain.constraint_row_count}, the rows of the"
            f" grasps, or None, got {checks.short(generic_rank)}"
        )


def require_iterations(iterations: Any) -> None:
    """Refuse what is no number of iterations.

    Raises:
        StateError: naming what could be one.
    """
    if not _whole_or_none(iterations, 1, MOST_SOLVER_ITERATIONS):
        raise StateError(
            f"compile: iterations: expected an integer from 1 to {MOST_SOLVER_ITERATIONS}, or None, got"
            f" {checks.short(iterations)}"
        )


def _whole_or_none(x: Any, least: int, most: int) -> bool:
    return x is None or (isinstance(x, int | np.integer) and not isinstance(x, bool) and least <= int(x) <= most)


def optional_parameters(
    parameters: Sequence[str], what: str, route: Route = "auto", known: Sequence[str] = OPTIONAL
) -> Options:
    """Return the options for the optional parameters that a user requests.

    Args:
        parameters: their names.
        what: the name of the calling function, for messages.
        route: how the inverse inertia at each arm's tip is computed.
        known: the names that there are.

    Raises:
        StateError: A name is not one of them.
    """
    checks.instance(parameters, (list, tuple, set, frozenset), f"{what}: parameters", StateError)
    for name in parameters:
        if not isinstance(name, str) or name not in known:
            raise StateError(
                f"{what}: no optional parameter {checks.short(name)}.{checks.did_you_mean(str(name), known)}"
            )
    return Options(
        route,
        "link_inertia" in parameters,
        "link_wrench" in parameters,
        further=tuple(name for name in known if name in parameters and name not in OPTIONAL),
    )


@dataclass(frozen=True, eq=False)
class Structure:
    """A chain as the compiler sees it: arms by type, grasps by kind.

    Attributes:
        chain: the chain.
        options: the options with which it is compiled.
        by_grasp: whether arms with different kinds of grasp have different types, because the computation depends on
            the grasps.
        by_links: whether arms with different link inertias have different types, because the computation depends on
            them.
        by_limits: whether arms whose grasps have other limits have different types.
    """

    chain: ClosedChain
    options: Options
    by_grasp: bool = True
    by_links: bool = True
    by_limits: bool = False

    @cached_property
    def types(self) -> dict[str, list[int]]:
        """The rows of the arms of each type, by the digest of the type, in order of appearance."""
        found: dict[str, list[int]] = {}
        for row, name in enumerate(self.chain.names):
            found.setdefault(self.type_of[name], []).append(row)
        return found

    @cached_property
    def key(self) -> str:
        """A digest of everything on which the code depends: arm types in order, options, trunk and springs."""
        names = list(self.types)
        order = [names.index(self.type_of[name]) for name in self.chain.names]
        trunk = [] if self.chain.trunk is None else [*_of_trunk(self.chain, self.options.link_inertia)]
        elements = [f"{type(one).__qualname__} {fingerprint(one)}".encode() for one in self.chain.springs]
        touching = self.chain.touching
        elements += [] if touching is None else [code_key(touching).encode()]
        return digest_of([repr((names, order, self.options)).encode(), *trunk, *elements])

    @cached_property
    def type_of(self) -> dict[str, str]:
        """The digest of each arm's type, by arm name; arms of one type share their code."""
        return {name: self._digest_of(name) for name in self.chain.names}

    def _digest_of(self, name: str) -> str:
        grasp = self.chain.grasps.get(name) if self.by_grasp else None
        kind = _key_of(grasp.of_kind) if grasp else "none"
        if grasp and self.by_limits:
            limits = grasp.wrench_limits or WrenchLimits()
            kind += repr((grasp.contact is None, math.isinf(limits.force), math.isinf(limits.moment)))
        folded = _folded(self.chain.arms[name], self.options.link_inertia or not self.by_links)
        return digest_of([kind.encode(), *folded])


@functools.cache
def _key_of(kind: GraspKind) -> str:
    """Return a key of a grasp kind; a kind with user-defined functions gets a random key, so it is never cached."""
    return code_key(kind)


def _folded(arm: Arm, without_links: bool) -> Iterator[bytes]:
    """Yield the bytes of all numbers of an arm that become constants of the code."""
    for joint in arm.joints:
        yield repr((joint.turns, joint.travel)).encode()
        yield from (joint.axis.tobytes(), joint.placement.R.tobytes(), joint.placement.p.tobytes())
        spring = [joint.stiffness, joint.rest] if joint.stiffness else []
        yield np.array([joint.armature, joint.damping, *spring]).tobytes()
    if not without_links:
        for link in arm.links:
            yield np.array([link.mass, *link.com, *link.inertia.flat]).tobytes()
    yield from (arm.tip.R.tobytes(), arm.tip.p.tobytes())


def _of_trunk(chain: ClosedChain, without_links: bool) -> Iterator[bytes]:
    """Yield the bytes of a trunk's numbers that become constants, and of which arm is mounted on which body."""
    trunk = chain.trunk
    assert trunk is not None
    yield repr((chain.names, dict(chain.mounted_on))).encode()
    if trunk.serial is not None:
        yield from _folded(trunk.serial, without_links)
    if trunk.floating is not None:
        link = trunk.floating
        yield b"floating" if without_links else np.array([link.mass, *link.com, *link.inertia.flat]).tobytes()
    else:
        yield from (trunk.base.R.tobytes(), trunk.base.p.tobytes())
