"""The computations of a compiled chain besides forward dynamics; each traces a function of the reference."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.compiled.externals import (
    FLOATING,
    STATE,
    TRUNK_BASE_MOTION,
    externals,
    link_parameters,
    shapes,
    starts,
    state_fields,
)
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.closure_derivatives import CLOSURE, rows_of
from holdfast.dynamics.energy import (
    centre_of_mass,
    total_kinetic_energy,
    total_mass_moment,
    total_momentum,
    total_potential_energy,
)
from holdfast.dynamics.inverse import torques_and_deciding
from holdfast.dynamics.kinematics import link_frames
from holdfast.dynamics.linearised_function import Differentiable
from holdfast.dynamics.object_level import object_mobility
from holdfast.dynamics.possible_motion import deciding
from holdfast.dynamics.projection import after_step
from holdfast.dynamics.trunk.trunk_derivatives import FLOATING_RESULT
from holdfast.dynamics.trunk.trunk_motion import standing
from holdfast.dynamics.varied_case import VariedCase
from holdfast.forces.force_derivatives import CONTACTS, LIMITS, MARGINS, OF_LIMITS, WRISTS
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_kinds import GraspKind
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, concatenate, each

Found = Mapping[str, Any]

CLOSED = "closed."  # the prefix of the names of a returned state's arrays
_OBJECT = ("object_mass", "object_com", "object_inertia")


@dataclass(frozen=True, eq=False)
class Computation:
    """A computation of a chain.

    Attributes:
        inputs: the names of its input arrays.
        parameters: the names of its run-time parameters; those of links are added if the options ask for them.
        function: takes the traced chain and the traced arrays; returns the results by name.
        results: the results that each arm has, by name: a function of joint count and grasp kind returns their size.
        whole: the results that the chain has only once, with their shapes, or functions of the chain that return
            them; None means the shape given by `shapes`.
        by_grasp: whether it depends on the kinds of the grasps.
        by_links: whether it depends on the inertias of the links.
        acting: whether forces act: external wrenches on the links, springs between bodies and bushings.
        closes: whether it returns a state, whose arrays are named with the prefix `CLOSED`.
        elastic: whether it depends on the forces or the energy of bushings.
        deciding: further results, with their shapes, that show whether its arguments are possible.
        unlimited: whether results may be infinite, as a margin without a limit is.
        further: the shapes of those inputs that `shapes` does not know, by name.
        fixed: the numbers of parameters that no call changes, by name.
    """

    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    function: Callable[[ClosedChain, Given], Found]
    results: Mapping[str, Callable[[int, GraspKind | None], int]] = field(default_factory=dict)
    whole: Mapping[str, Shape | Callable[[ClosedChain], Shape] | None] = field(default_factory=dict)
    by_grasp: bool = False
    by_links: bool = True
    acting: bool = False
    closes: bool = False
    elastic: bool = False
    unlimited: bool = False
    further: Mapping[str, Shape] = field(default_factory=dict)
    fixed: Mapping[str, Array] = field(default_factory=dict)
    deciding: Callable[[ClosedChain], Mapping[str, Shape]] = lambda chain: {}

    def structure(self, chain: ClosedChain, options: Options) -> Structure:
        """Return the chain with the options that this computation depends on; the others are reset."""
        own = Options("auto", options.link_inertia and self.by_links, options.link_wrenches and self.acting, True)
        return Structure(chain, own, self.by_grasp or self._by_bushings(chain), self.by_links)

    def _by_bushings(self, chain: ClosedChain) -> bool:
        """Return whether it depends on this chain's grasps because some of them are bushings."""
        return self.elastic and bool(chain.bushings)

    @property
    def _placed(self) -> bool:
        """Whether it depends on where the arms' bases are."""
        return "base_R" in self.parameters

    def externals(self, structure: Structure) -> dict[str, External]:
        """Return the arrays that it reads and writes."""
        chain, options = structure.chain, structure.options
        inputs, parameters = list(self.inputs), list(self.parameters)
        if options.link_wrenches:
            inputs += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else ())]
        parameters += link_parameters(chain) if options.link_inertia else ()
        parameters += ("grasp_R", "grasp_p") if self._by_bushings(chain) else ()
        inputs += self.by_name(chain)
        parameters += ("base_p",) if self.by_place(chain) else ()
        if chain.trunk is not None and self._placed:
            parameters += [name for name in ("base_R", "base_p") if name not in parameters]
            parameters += TRUNK_BASE_MOTION if "base_twist" in parameters and not chain.floats else ()
        known = shapes(chain)
        outputs: dict[str, Shape] = {name: (self.starts(chain, name)[-1],) for name in self.results}
        for name in state_fields(chain) if self.closes else ():
            outputs[f"{CLOSED}{name}"] = known[name]
        for name, shape in self.whole.items():
            outputs[name] = known[name] if shape is None else shape(chain) if callable(shape) else shape
        outputs |= self.deciding(chain)
        of_fixed = {name: x.shape for name, x in self.fixed.items()}
        return externals(inputs, [*parameters, *of_fixed], outputs, known | {**self.further, **of_fixed, **outputs})

    def by_place(self, chain: ClosedChain) -> bool:
        """Return whether it depends on where this chain's arms and object are because of forces between them."""
        return self.acting and bool(chain.springs or chain.bushings)

    def by_name(self, chain: ClosedChain) -> list[str]:
        """Return the inputs that only some chains have.

        They are the pose of a floating base, its twist and acceleration if other velocities or accelerations are among
        the inputs, and the pose and twist of the object if forces depend on them.
        """
        found = ["object_pose", "object_twist"] if self.by_place(chain) else []
        if chain.floats and self._placed:
            found += FLOATING if {"qd", "object_twist"} & {*self.inputs} else FLOATING[:1]
            found += [FLOATING_RESULT] if "qdd" in self.inputs else []
        return found

    def starts(self, chain: ClosedChain, result: str) -> list[int]:
        """Return the offset of each arm's part of a result, and the end of the last part."""
        kinds = [chain.grasps[name].of_kind if name in chain.grasps else None for name in chain.arms]
        sizes = zip(chain.arms.values(), kinds, strict=True)
        return starts(self.results[result](arm.joint_count, kind) for arm, kind in sizes)

    def schedule(self, structure: Structure) -> Schedule:
        """Return the schedule for one chain."""
        return traced(self.externals(structure), lambda given: self.function(traced_chain(structure, given), given))


def _torques(chain: ClosedChain, x: Given) -> Found:
    state = traced_state(chain, x)
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), traced_inputs(chain, x))
    found = torques_and_deciding(motion, x["qdd"], x["grasp_wrench"], x.get(FLOATING_RESULT))
    return dict(zip(("tau", *deciding(chain)), found, strict=True))


def _of_function(function: Differentiable) -> Callable[[ClosedChain, Given], Found]:
    """Return what computes the results of a differentiable function, for the computation of its name."""
    return lambda chain, x: dict(
        zip(function.results, function.compute(traced_case(chain, x, function.name)), strict=True)
    )


def _mass_matrices(chain: ClosedChain, x: Given) -> Found:
    arms = chain.arms.values()  # the mass matrix does not depend on where the bases are
    return {
        "mass_matrix": _by_arm(lambda arm, q: mass_matrix(arm, forward_kinematics(arm, q))[0].ravel(), chain, x, arms)
    }


def _jacobians(chain: ClosedChain, x: Given) -> Found:
    return {"jacobian": _by_arm(lambda arm, q: jacobian(arm, forward_kinematics(arm, q)).ravel(), chain, x)}


def _by_arm(f: Callable[[Arm, Array], Array], chain: ClosedChain, x: Given, arms: Iterable[Arm] | None = None) -> Array:
    arms = standing(chain, traced_state(chain, x), traced_inputs(chain, x)).arms.values() if arms is None else arms
    return concatenate(each(f, arms, [x["q"][part] for part in chain.arm_joints]))


def _momentum(chain: ClosedChain, x: Given) -> Found:
    return {"momentum": total_momentum(chain, traced_state(chain, x), traced_inputs(chain, x), x["about"])}


def _accounts(chain: ClosedChain, x: Given) -> Found:
    state, inputs = traced_state(chain, x), traced_inputs(chain, x)
    return {
        "kinetic": total_kinetic_energy(chain, state, inputs),
        "potential": total_potential_energy(chain, state),
        "momentum": total_momentum(chain, state, inputs, np.zeros(3)),
        "mass_moment": total_mass_moment(chain, state),
        "tip_R": _by_arm(lambda arm, q: forward_kinematics(arm, q).tip.R.ravel(), chain, x),
    }


def _tip_poses(chain: ClosedChain, x: Given) -> Found:
    return {"frame": _by_arm(lambda arm, q: _frame(forward_kinematics(arm, q).tip), chain, x)}


def _link_poses(chain: ClosedChain, x: Given) -> Found:
    return {
        "frame": _by_arm(lambda arm, q: concatenate(map(_frame, link_frames(forward_kinematics(arm, q)))), chain, x)
    }


def _frame(pose: Pose) -> Array:
    return concatenate([pose.R.ravel(), pose.p])


def _project(chain: ClosedChain, x: Given) -> Found:
    found = after_step(chain, traced_state(chain, x), traced_inputs(chain, x))
    return {f"{CLOSED}{name}": getattr(found, field) for name, field in state_fields(chain).items()}


COMPUTATIONS: dict[str, Computation] = {
    "inverse_dynamics": Computation(
        ("q", "qd", "qdd", "grasp_wrench"),
        ("gravity", "base_R", "base_twist", "base_acceleration"),
        _torques,
        whole={"tau": None},
        acting=True,
        elastic=True,
        deciding=deciding,
    ),
    "joint_margins": Computation(
        ("q", "qd", "tau"),
        (LIMITS,),
        _of_function(OF_LIMITS),
        whole=dict.fromkeys(OF_LIMITS.results, lambda chain: (chain.joint_count,)),
        by_links=False,
        unlimited=True,
    ),
    "grasp_margins": Computation(
        ("object_pose", "grasp_wrench"),
        (CONTACTS, "grasp_R"),
        _of_function(MARGINS),
        whole={"grasp_margins": lambda chain: (len(chain.grasps),)},
        by_grasp=True,
        by_links=False,
        unlimited=True,
    ),
    "wrist_wrenches": Computation(
        ("q", "grasp_wrench"),
        ("base_R",),
        _of_function(WRISTS),
        whole={"wrist_wrenches": lambda chain: (len(chain.arms), 6)},
        by_links=False,
    ),
    "mass_matrix": Computation(("q",), (), _mass_matrices, {"mass_matrix": lambda N, _: N * N}),
    "jacobian": Computation(("q",), ("base_R",), _jacobians, {"jacobian": lambda N, _: 6 * N}, by_links=False),
    "closure": Computation(
        STATE,
        ("base_R", "base_p", "base_twist", "grasp_R", "grasp_p"),
        _of_function(CLOSURE),
        {result: lambda _, kind, of=result: rows_of(kind, of) if kind else 0 for result in CLOSURE.results},
        by_grasp=True,
        by_links=False,
    ),
    "kinetic_energy": Computation(
        STATE,
        (*_OBJECT, "base_R", "base_twist"),
        lambda chain, x: {"energy": total_kinetic_energy(chain, traced_state(chain, x), traced_inputs(chain, x))},
        whole={"energy": ()},
    ),
    "potential_energy": Computation(
        ("q", "object_pose"),
        ("gravity", *_OBJECT, "base_R", "base_p"),
        lambda chain, x: {"energy": total_potential_energy(chain, traced_state(chain, x))},
        whole={"energy": ()},
        elastic=True,
    ),
    "momentum": Computation(
        STATE,
        ("about", *_OBJECT, "base_R", "base_p", "base_twist"),
        _momentum,
        whole={"momentum": (6,)},
    ),
    "centre_of_mass": Computation(
        ("q", "object_pose"),
        (*_OBJECT, "base_R", "base_p"),
        lambda chain, x: {"centre_of_mass": centre_of_mass(chain, traced_state(chain, x))},
        whole={"centre_of_mass": (3,)},
    ),
    "object_mobility": Computation(
        ("q", "object_pose"),
        (*_OBJECT, "base_R", "base_p", "grasp_R", "grasp_p"),
        lambda chain, x: {"object_mobility": object_mobility(chain, traced_state(chain, x))},
        whole={"object_mobility": (6, 6)},
        by_grasp=True,
    ),
    "tip_poses": Computation(("q",), ("base_R", "base_p"), _tip_poses, {"frame": lambda *_: 12}, by_links=False),
    "link_poses": Computation(
        ("q",), ("base_R", "base_p"), _link_poses, {"frame": lambda N, _: 12 * N}, by_links=False
    ),
    "project": Computation(
        STATE,
        (*_OBJECT, "base_R", "base_p", "base_twist", "grasp_R", "grasp_p"),
        _project,
        closes=True,
        by_grasp=True,
    ),
}


def own_inputs(function: str, chain: ClosedChain) -> tuple[str, ...]:
    """Return what a function of a chain is given besides the state and parameters of every chain."""
    base = COMPUTATIONS[function]
    inputs = (name for name in (*base.inputs, *base.by_name(chain)) if name not in (*STATE, *FLOATING))
    return *inputs, *(name for name in base.parameters if name in (LIMITS, CONTACTS))


def traced_case(chain: ClosedChain, x: Given, function: str) -> VariedCase:
    """Return the traced arguments of a function that can be differentiated."""
    own = {name: x[name] for name in own_inputs(function, chain)}
    return VariedCase(chain, traced_state(chain, x), traced_inputs(chain, x), own)


ACCOUNTS = Computation(  # the energies and momenta of a state that a simulation's balances need, in one call
    STATE,
    ("gravity", *_OBJECT, "base_R", "base_p", "base_twist"),
    _accounts,
    {"tip_R": lambda *_: 9},
    {"kinetic": (), "potential": (), "momentum": (6,), "mass_moment": (4,)},
    elastic=True,
)
