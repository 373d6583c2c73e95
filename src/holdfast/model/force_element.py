"""Force elements: massless parts between points on two bodies, with wrenches that follow from the points' motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, Self

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.trunk import TRUNK, Trunk
from holdfast.spatial.frozen import REQUIRED, ArrayField, Converted, Frozen
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.vector import cross

WORLD, HELD_OBJECT = "world", "object"


@dataclass(frozen=True, eq=False)
class SpringEnd(Frozen):
    """An end of a spring, a point on a body.

    Attributes:
        body: "world", "object", the name of an arm, or "trunk".
        point: (3,) position in the frame of the world, the object or the link [m].
        link: link of an arm or trunk: its name, or its number from 0 at the base, or "base" for the floating body of a
            trunk; None for the world and the object.
    """

    body: str
    point: ArrayField = REQUIRED
    link: str | int | None = None

    def __post_init__(self) -> None:
        checks.instance(self.body, str, "spring: body")
        object.__setattr__(self, "point", checks.numbers(self.point, (3,), f"spring: point on '{self.body}'"))
        if self.link is None:
            if self.body not in (WORLD, HELD_OBJECT):
                raise ModelError(
                    f"spring: '{self.body}': expected 'world' or 'object', or an arm and a link of it, got no link; try"
                    f" ('{self.body}', link, point), the link by its name or its number from 0"
                )
        elif isinstance(self.link, bool) or not isinstance(self.link, str | int):
            raise ModelError(
                f"spring: '{self.body}': link: expected a name or a number, got {type(self.link).__name__}"
            )

    @property
    def on_arm(self) -> bool:
        """Whether the end is on a link of an arm."""
        return self.link is not None and not self.on_trunk

    @property
    def on_trunk(self) -> bool:
        """Whether the end is on a body of a trunk."""
        return self.body == TRUNK

    def link_number(self) -> int:
        """Return the number of the link of an end on an arm, after `found`."""
        assert isinstance(self.link, int)
        return self.link

    def found(self, arms: Mapping[str, Arm], trunk: Trunk | None = None) -> SpringEnd:
        """Return the same end with the link of an arm given by its number; a link of a trunk is not changed.

        Raises:
            ModelError: there is no such arm, or no such link.
        """
        if self.link is None:
            return self
        if self.on_trunk and trunk is not None:
            trunk.body(self.link, f"spring: point on '{TRUNK}'")
            return self
        if self.body not in arms:
            raise ModelError(f"spring: no arm '{self.body}'.{checks.did_you_mean(self.body, arms)}")
        links = [link.name for link in arms[self.body].links]
        if isinstance(self.link, str):
            named = [k for k, name in enumerate(links) if name == self.link]
            if len(named) != 1 or not self.link:
                known = checks.did_you_mean(self.link, [name for name in links if name])
                raise ModelError(f"spring: arm '{self.body}' has {len(named) or 'no'} links '{self.link}'.{known}")
            return replace(self, link=named[0])
        if not 0 <= self.link < len(links):
            raise ModelError(
                f"spring: arm '{self.body}': link: expected a number from 0 to {len(links) - 1}, got {self.link}"
            )
        return self


class EndMotion(NamedTuple):
    """The motion of an end of a force element at one instant, in world axes.

    Attributes:
        lever: (3,) from the origin of its body to the end [m].
        position: (3,) position in the world [m].
        velocity: (3,) velocity [m/s].
        R: (3, 3) rotation from the body's axes to world axes.
        omega: (3,) angular velocity of the body [rad/s].
    """

    lever: Array
    position: Array
    velocity: Array
    R: Array
    omega: Array

    def wrench(self, load: EndLoad) -> Array:
        """Return the wrench of a load on the body, (6,) about the body's origin."""
        moment = cross(self.lever, load.force)
        return concatenate([moment if load.moment is None else moment + load.moment, load.force])


class EndLoad(NamedTuple):
    """What a force element exerts at one of its ends, in world axes.

    Attributes:
        force: (3,) force at the end [N].
        moment: (3,) moment about the end [N m]; None for no moment.
    """

    force: Array
    moment: Array | None = None


class Deformation(Protocol):
    """A force element at one instant: its law, in the vocabulary of `spatial.scalar`."""

    def loads(self) -> tuple[EndLoad, EndLoad]:
        """Return what the element exerts on the bodies of its two ends."""
        ...

    def energy(self) -> Scalar:
        """Return the stored energy, which depends on positions and attitudes only [J]."""
        ...

    def loss(self) -> Scalar:
        """Return the dissipated power: minus the power of the wrenches, minus the rate of the energy; >= 0 [W]."""
        ...


@dataclass(frozen=True, eq=False)
class ForceElement(Frozen, ABC):
    """A massless part that exerts wrenches on the bodies of its two ends.

    A kind of force element is a subclass whose further fields are its parameters, and its `Deformation`. Dynamics,
    energy balances and compiled code use nothing else of it; derivatives follow by automatic differentiation.

    Attributes:
        a: one end, ("world", point), ("object", point), (arm, link, point) or ("trunk", link, point).
        b: the other end, likewise.
    """

    a: Converted[SpringEnd, SpringEnd | tuple[Any, ...]] = REQUIRED
    b: Converted[SpringEnd, SpringEnd | tuple[Any, ...]] = REQUIRED

    def __post_init__(self) -> None:
        for side in ("a", "b"):
            object.__setattr__(self, side, _end(getattr(self, side), side))
        super().__post_init__()

    @abstractmethod
    def between(self, a: EndMotion, b: EndMotion) -> Deformation:
        """Return the element at the instant at which its ends have the given motion."""

    @property
    def ends(self) -> tuple[SpringEnd, SpringEnd]:
        """Both ends of the element."""
        return self.a, self.b

    def found(self, arms: Mapping[str, Arm], trunk: Trunk | None = None) -> Self:
        """Return the same element with links of arms given by their numbers.

        Raises:
            ModelError: there is no such arm, or no such link.
        """
        return replace(self, a=self.a.found(arms, trunk), b=self.b.found(arms, trunk))


def _end(given: Any, side: str) -> SpringEnd:
    """Return an end that is given as a `SpringEnd` or as a tuple."""
    if isinstance(given, SpringEnd):
        return given
    if not isinstance(given, tuple | list) or len(given) not in (2, 3):
        raise ModelError(
            f"spring: {side}: expected ('world', point), ('object', point) or (arm, link, point), got"
            f" {checks.short(given)}"
        )
    body, *link, point = given
    return SpringEnd(body, point, *link)
