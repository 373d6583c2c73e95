"""The keyword arguments of `simulate` from a scene's data: events, surroundings, scheme, policies."""

from __future__ import annotations

from typing import Any

from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK
from holdfast.scenario import parts
from holdfast.scenario.scene import ReleaseTable, SceneTable
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.events import Attach, Event, Release, holding_after
from holdfast.simulation.run_record import record_settings
from holdfast.simulation.zero_order_hold import zero_order_hold

SIMULATION_KEYS = (  # passed on to `simulate`
    "on_slip", "on_limit", "on_singular", "scheme", "rtol", "atol", "largest_drift", "sample_time", "delay",
    "record", "every", "contacts",
)  # fmt: skip


def simulation_options(data: SceneTable, chain: ClosedChain, at: Location) -> dict[str, Any]:
    """Return the keyword arguments of `simulate`: events, surroundings, scheme, policies.

    Raises:
        SceneError: with the path of the first fault.
    """
    how = data.simulation
    pushed = parts.pushes(data.wrenches, [*chain.free_objects], at / "wrenches")
    swaying = base_motions(data, chain, at)
    with (at / "simulation").refusals():
        Tolerance(how.rtol, how.atol)
        if how.largest_drift is not None:
            checks.number(how.largest_drift, "simulation: largest_drift", above=0.0)
        zero_order_hold(how.sample_time, how.delay, how.duration, [])
        record_settings(how.record, how.every, how.step, chain)
    return {
        "events": events(data, chain, at / "events"),
        "base_motion": swaying,
        "inputs": pushed if data.wrenches else None,
        # the jerk of a base jumps at the end of its smooth start
        "breakpoints": [*how.breakpoints, *pushed.breakpoints, *(base.smooth_start for base in swaying.values())],
        **{name: getattr(how, name) for name in SIMULATION_KEYS},
    }


def base_motions(data: SceneTable, chain: ClosedChain, at: Location) -> dict[str, parts.SwayingBase]:
    """Return the motions of bases in the world, by arm name, "trunk" for the trunk, and of shapes of the world.

    Raises:
        SceneError: with the path of the first fault.
    """
    moving = {
        arm.name: parts.swaying_base(arm.base_motion, chain.arms[arm.name].base, at / "arms" / i / "base_motion")
        for i, arm in enumerate(data.arms)
        if arm.base_motion is not None
    }
    if data.trunk is not None and data.trunk.base_motion is not None:
        assert chain.trunk is not None
        moving[TRUNK] = parts.swaying_base(data.trunk.base_motion, chain.trunk.base, at / TRUNK / "base_motion")
    shapes = () if chain.touching is None else [one.pose for one in chain.touching.world.values()]
    for i, (one, rest) in enumerate(zip(data.world, shapes, strict=False)):
        if one.base_motion is not None:
            moving[one.name] = parts.swaying_base(one.base_motion, rest, at / "world" / i / "base_motion")
    return moving


def events(data: SceneTable, chain: ClosedChain, at: Location) -> list[Event]:
    """Return the events, after checking each against those before it.

    Raises:
        SceneError: with the path of the event at fault.
    """
    made: list[tuple[int, Event]] = []
    for i, one in enumerate(data.events):
        if isinstance(one, ReleaseTable):
            made.append((i, Release(one.t, parts.grasp_key(one))))
        else:
            made.append((i, Attach(one.t, parts.grasp_key(one), parts.grasp(one, at / i, one.of), one.here)))
    made.sort(key=lambda placed: placed[1].t)
    holding = frozenset(chain.grasps)
    for i, event in made:
        with (at / i).refusals():
            holding = holding_after(event, holding, chain, data.simulation.duration)
    return [event for _, event in made]
