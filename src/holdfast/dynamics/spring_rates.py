"""How the wrenches of springs between bodies change with a chain's state: the springs' own text, made linear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.forward_derivatives import POSES, numbers_of
from holdfast.dynamics.closed.pose_tangents import by_motion, by_motions, rates_of
from holdfast.dynamics.closed.spring_wrenches import with_springs
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

# The arguments that move the ends of springs.
MOVING_ENDS = ("q", "qd", "object_pose", "object_twist", "base_pose", "base_twist")


class SpringRates(NamedTuple):
    """The wrenches of a chain's springs made linear in some arguments.

    Attributes:
        names: of the arguments.
        numbers: what they are made of, by name: rotations of bases stacked.
        linear: the wrenches on the object (6,) and on the links (n, 6).
    """

    names: tuple[str, ...]
    numbers: Mapping[str, Array]
    linear: Linear

    def forward(self, tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return tangents with the rates of change of the springs' wrenches added."""
        rates: dict[str, Array] = {name: np.zeros_like(x) for name, x in self.numbers.items()}
        rates |= {name: tangents[name] for name in self.names if name in tangents and name not in POSES}
        if "object_pose" in tangents:
            rates |= rates_of(tangents, "object", self.numbers["object_R"])
        if "base_pose" in tangents:
            pairs = zip(tangents["base_pose"], self.numbers["base_R"], strict=True)
            each = [rates_of({"base_pose": x}, "base", R) for x, R in pairs]
            rates |= {name: np.array([one[name] for one in each]) for name in ("base_R", "base_p")}
        of_object, of_links = self.linear.rates(*(rates[name] for name in self.numbers))
        return {
            **tangents,
            "object_wrench": tangents.get("object_wrench", 0.0) + of_object,
            "link_wrench": tangents.get("link_wrench", 0.0) + of_links,
        }

    def backward(self, of_object: Array, of_links: Array) -> dict[str, Array]:
        """Return what the arguments' gradients have of those by the wrenches on the object and on the links."""
        found: dict[str, Any] = dict(zip(self.numbers, self.linear.gradient(of_object, of_links), strict=True))
        if "object_pose" in self.names:
            found["object_pose"] = by_motion(found["object_R"], self.numbers["object_R"], found["object_p"])
        if "base_pose" in self.names:
            found["base_pose"] = by_motions(found["base_R"], self.numbers["base_R"], found["base_p"])
        return {name: found[name] for name in self.names}


def spring_rates(chain: ClosedChain, state: State, inputs: Inputs, names: Sequence[str]) -> SpringRates | None:
    """Return the springs' wrenches made linear in those of the named arguments that they depend on.

    Args:
        chain: without a trunk.
        state: positions and velocities.
        inputs: shaped inputs.
        names: of arguments.

    Returns:
        None where there are no springs, or nothing named moves their ends.
    """
    names = tuple(name for name in names if name in MOVING_ENDS)
    if not chain.springs or not names:
        return None
    bases = [arm.base for arm in chain.arms.values()]
    own: dict[str, Any] = {
        "q": state.q,
        "qd": state.qd,
        "object_R": state.object_frame.R,
        "object_p": state.object_frame.p,
    }
    own |= {"object_twist": state.object_twist, "base_twist": inputs.base_twists}
    own |= {"base_R": np.array([b.R for b in bases]), "base_p": np.array([b.p for b in bases])}
    numbers = {name: own[name] for name in numbers_of(names)}

    def wrenches(*x: Array) -> tuple[Array, Array]:
        given = own | dict(zip(numbers, x, strict=True))
        moved, still = object.__new__(State), object.__new__(Inputs)
        moved.__dict__.update(vars(state), q=given["q"], qd=given["qd"], object_twist=given["object_twist"])
        moved.__dict__.update(object_frame=Pose.unchecked(given["object_R"], given["object_p"]))
        still.__dict__.update(vars(inputs), base_twists=given["base_twist"])
        arms = zip(chain.arms.items(), given["base_R"], given["base_p"], strict=True)
        other = object.__new__(ClosedChain)
        other.__dict__.update(vars(chain), arms={n: a.standing_at(Pose.unchecked(R, p)) for (n, a), R, p in arms})
        found = with_springs(other, moved, still)
        assert found.object_wrench is not None and found.link_wrenches is not None
        return found.object_wrench, found.link_wrenches

    return SpringRates(names, numbers, linearised(wrenches, *numbers.values()))
