"""Springs and dampers between two points of the world, links and the object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.trunk import NAME as TRUNK
from holdfast.model.trunk import Trunk
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, Converted, Frozen

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


@called
@dataclass(frozen=True, eq=False)
class Spring(Frozen):
    """A massless spring and damper along the line between two points.

    Its tension is k (s - L) + c ds/dt with the distance s of the points. With natural length 0 it is a linear spring in
    every direction. With another length it exerts no force while its ends coincide, because it has no direction then.

    Attributes:
        a: one end, ("world", point), ("object", point), (arm, link, point) or ("trunk", link, point). The link is
            given by its name or its number from 0 at the base, or is "base" for a floating body. The point is in the
            frame of its body [m].
        b: the other end, likewise.
        stiffness: k >= 0 [N/m].
        length: natural length L >= 0 [m].
        damping: c >= 0 [N s/m].
    """

    a: Converted[SpringEnd, SpringEnd | tuple[Any, ...]] = REQUIRED
    b: Converted[SpringEnd, SpringEnd | tuple[Any, ...]] = REQUIRED
    stiffness: float = REQUIRED
    length: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        for side in ("a", "b"):
            put(self, side, _end(getattr(self, side), side))
        for quantity in ("stiffness", "length", "damping"):
            put(self, quantity, checks.number(getattr(self, quantity), f"spring: {quantity}", at_least=0.0))

    @property
    def ends(self) -> tuple[SpringEnd, SpringEnd]:
        """Both ends of the spring."""
        return self.a, self.b

    def found(self, arms: Mapping[str, Arm], trunk: Trunk | None = None) -> Spring:
        """Return the same spring with links of arms given by their numbers.

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
