"""Simulation of a closed chain under a controller, always on the constraint."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.clipped import clipped
from holdfast.control.compiled_law import CompiledLaws
from holdfast.control.controller import ControlLaw, Controller, given_law, machine_code, require_controller
from holdfast.dynamics.near_singular import NEAR, nearly_lost
from holdfast.errors import HoldfastError, ModelError, StateError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.progress import of_time, reporting
from holdfast.simulation.accounts import WORTH_COMPILING
from holdfast.simulation.adaptive import RTOL, Tolerance
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.events import Event, in_order
from holdfast.simulation.external_inputs import GivenInputs
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import OnLimit, OnSingular, OnSlip, Policy
from holdfast.simulation.rollout.compiled_steppers import stepper_for
from holdfast.simulation.run import next_state, resumed_run, start_of_run
from holdfast.simulation.run_state import RunState
from holdfast.simulation.runge_kutta import scheme as scheme_named
from holdfast.simulation.sample import Recorder
from holdfast.simulation.segment import MakeStepper, RunSettings
from holdfast.simulation.setting import Setting, recorded_base
from holdfast.simulation.stops import ALIKE, MOST_STEPS, step_times, stops
from holdfast.simulation.trajectory import Trajectory, array_names, stacked
from holdfast.simulation.verification import LOOKS
from holdfast.simulation.zero_order_hold import zero_order_hold
from holdfast.state import Inputs, State, require_fit


@np.errstate(all="ignore")  # a run that diverges ends in a StateError, not in warnings
def simulate(
    chain: ClosedChain,
    state: State,
    controller: Controller | ControlLaw,
    duration: float,
    step: float,
    *,
    base_motion: Mapping[str, BaseMotion] | None = None,
    inputs: GivenInputs | None = None,
    events: Sequence[Event] = (),
    breakpoints: Iterable[float] = (),
    parameters: Mapping[str, ArrayLike] | None = None,
    sample_time: float | None = None,
    delay: float = 0.0,
    on_slip: OnSlip = "stop",
    on_limit: OnLimit = "record",
    on_singular: OnSingular = "stop",
    scheme: str = "rk4",
    rtol: float = RTOL,
    atol: float | None = None,
    largest_drift: float | None = None,
    start: Checkpoint | None = None,
    progress: bool | Callable[[float], object] | None = None,
    on_sample: Callable[[Trajectory], None] | None = None,
    on_checkpoint: Callable[[Checkpoint], None] | None = None,
    make_stepper: MakeStepper | None = None,
    name: str = "run",
) -> Trajectory:
    """Return the motion from a state, by Runge-Kutta steps with projection, contacts verified all along.

    A step that turns singular, cannot be closed again or is not finite ends the run, and so does a grasp that
    slips (see `on_slip`): what came before is returned, `stopped` says why and when.

    Margins of one-sided grasps and of joint limits are looked at inside every step; what is found for certain
    is said in `simulation.verification`. A chain without either costs nothing extra.

    Args:
        chain: arms, object and grasps.
        state: where to start; must satisfy the grasps.
        controller: (t, state, memory) -> (torques (n,), memory), memory None at first. Its attribute
            `breakpoints`, if it has one, says at which times its torques jump; its method `for_chain(chain)`,
            if it has one, is asked for a controller whenever a grasp closes or opens.
        duration: [s].
        step: h [s]; the last step is shorter where h does not divide the duration. An adaptive scheme
            takes shorter ones where it must, none across a multiple of h; every step is a sample.
        base_motion: t -> (pose, twist, acceleration) of moving bases, by arm name, or "trunk" for a trunk's.
        inputs: external wrenches, constant or a function of t, or of (t, state): one that cannot be called with t
            alone. It is asked at every stage for the time and state there, and may give wrenches only.
        events: `Attach` and `Release` at given times.
        breakpoints: times at which torques or inputs jump or change their course; steps end there.
        parameters: values of a `ControlLaw`'s parameters, by name; others take none.
        sample_time: of a digital controller [s]: it is asked once a sample, with the state of that moment, and its
            torques are held until the next (zero-order hold); steps end at samples. None: asked at every stage.
        delay: from a sample to when its torques act [s]; until then those before, at first those of the first sample.
        on_slip: what is done about a grasp that cannot hold: "stop", "record" (and go on as if it held), or
            "release" (it opens; velocities go on).
        on_limit: what is done about a joint beyond a limit: "record" or "stop"; "clip": torques beyond an effort limit
            are clipped to it (its margin is 0 then), and the other limits recorded.
        on_singular: what is done about a singular configuration on the way: "stop" before it, or "continue" through it
            where only one motion with continuous velocities leads on; steps then end beside it.
        scheme: "rk4", "midpoint" or "dop853" (adaptive, order 8).
        rtol: relative tolerance of an adaptive scheme, see `adaptive.Tolerance`.
        atol: absolute tolerance.
        largest_drift: a fixed step that leaves the grasps open by more than this before projection, 1e-10 say, is
            too long for the motion and taken in equal parts [m or rad]; None: every step is taken whole.
        start: where to go on instead of at the beginning; `state` is not used then, and the samples returned
            are those after it.
        progress: True: a bar shows how far the run is, in a notebook or on a terminal. Or what is called with the
            time after every step.
        on_sample: called with every sample as it is made.
        on_checkpoint: called after that with what the run can go on from.
        make_stepper: what takes the steps; without it machine code does, unless there are too few to compile for.
        name: what the run is called in pages and files.

    Raises:
        ModelError: a duration or step that is not positive, too many steps, an unknown policy or scheme, an
            impossible event, a sample time or delay that no run can have, or a controller that is no function.
        StateError: the initial state breaks a grasp, the controller returns no torques and memory that fit, or the
            parameters are not those of its law.
        SingularChainError: the initial configuration is singular.
    """
    checks.instance(chain, ClosedChain, "simulation: chain")
    checks.instance(state, State, "simulation: state", StateError)
    require_controller(controller)
    checks.instance(name, str, "simulation: name")
    named = scheme_named(scheme)
    grid = step_times(duration, step)
    require_fit(chain, state)
    ordered = in_order(events, chain, float(grid[-1]))
    if not checks.is_listed(breakpoints):
        raise ModelError(f"simulation: breakpoints: expected times, got {checks.short(breakpoints)}")
    jumps = checks.vector([*breakpoints], "simulation: breakpoints").tolist()
    happening = [one.t for one in ordered]
    hold = zero_order_hold(sample_time, delay, float(grid[-1]), [*jumps, *happening])
    if hold is None:
        ends = stops(grid, [*jumps, *getattr(controller, "breakpoints", ())], happening, ALIKE * step)
    else:
        ends = stops(grid, [*jumps, *hold.jumps], happening, ALIKE * step, hold.asked.tolist())
    environment = Environment(chain, {} if base_motion is None else base_motion, Inputs() if inputs is None else inputs)
    policy, tolerance = Policy(on_slip, on_limit, on_singular), Tolerance(rtol, atol)
    make = make_stepper or partial(stepper_for, steps=int((~ends.jumps).sum()))
    limit = None if largest_drift is None else checks.number(largest_drift, "simulation: largest_drift", above=0.0)
    if policy.on_limit == "clip":
        controller = clipped(controller, chain)
    acting = given_law(controller, parameters)
    settings = RunSettings(environment, acting, hold, make, named, tolerance, limit, policy, ordered, ends)

    calls = len(ends.times) * (1 if hold else len(named.c) * (LOOKS if joint_limits(chain).limited.any() else 1))
    doing, begin = f"simulating {name}", f"{duration:g} s in {len(grid) - 1} steps"
    samples, recorder = list[Trajectory](), Recorder(0 if environment.base_motion else len(ends.times))
    with laws_by_machine_code(chain, calls), reporting(progress, doing, begin, of_time(duration)) as tell:
        at = start_of_run(settings, state) if start is None else resumed_run(settings, start)
        first = reported = 0 if start is None else len(start.occurrences)

        def keep(at: RunState) -> None:
            nonlocal reported
            happened = at.checkpoint.occurrences
            samples.append(
                recorder.sample(at.now, at.gaps, at.checkpoint.sums, at.times, at.margins, happened[reported:])
            )
            reported = len(happened)
            if on_sample is not None:
                on_sample(samples[-1])
            if on_checkpoint is not None:
                on_checkpoint(at.checkpoint)

        if start is None:
            keep(at)
        while True:
            try:
                later = next_state(at)
            except HoldfastError as cause:
                later = f"stopped after t = {at.now.t:.6g} s: {reason(cause, at.now)}"
            if not isinstance(later, RunState):
                break
            if len(samples) > MOST_STEPS + len(ends.times):  # of its own an adaptive scheme would go on for ever
                later = f"stopped after t = {at.now.t:.6g} s: more than {MOST_STEPS} steps; try a larger rtol"
                break
            if later.now.t > at.now.t:
                keep(later)
                tell(later.now.t)
            at = later
    if not samples:  # a run that went on from its end
        none = stacked([recorder.sample(at.now, at.gaps, at.checkpoint.sums, at.times, at.margins)], later)
        run = replace(none, **{name: getattr(none, name)[:0] for name in array_names()})
    else:
        run = replace(stacked(samples, later), occurrences=at.checkpoint.occurrences[first:])
    moved = {base: recorded_base(base, motion, run.t) for base, motion in environment.base_motion.items()}
    asked = {"scheme": scheme, "on_slip": on_slip, "on_limit": on_limit, "on_singular": on_singular, "rtol": rtol}
    called = getattr(controller, "__qualname__", type(controller).__qualname__)
    asked |= {"atol": atol, "largest_drift": limit, "controller": called}
    asked |= {} if not parameters else {"parameters": {name: x.tolist() for name, x in acting.values.items()}}
    asked |= {} if hold is None else {"sample_time": hold.sample_time, "delay": hold.delay}
    return replace(run, setting=Setting(chain, moved, name, float(duration), float(step), asked))


@contextmanager
def laws_by_machine_code(chain: ClosedChain, calls: int) -> Iterator[None]:
    """Let ready-made controllers and control laws that are called on floats be machine code, where it is worth while.

    Args:
        chain: whose joints they drive.
        calls: how many there will be, about.
    """
    token = machine_code.set(CompiledLaws(chain) if calls >= WORTH_COMPILING else None)
    try:
        yield
    finally:
        machine_code.reset(token)


SINGULAR = (
    0.01  # strength of a direction: below it a singular configuration counts as the cause, above it as a possible one
)


def reason(cause: HoldfastError, last: Instant) -> str:
    """Return why a step failed, with the directions that are nearly lost at the last sample.

    Args:
        cause: what the step raised.
        last: the chain at the last accepted instant.
    """
    lost = nearly_lost(last.chain, last.state, SINGULAR)
    if lost:
        what = str(cause).partition("; try ")[0]
        return (
            f"{what}. The last configuration is nearly singular, where joint rates and forces grow without bound:"
            f" {'; '.join(lost)}. Try a motion that keeps away from it"
        )
    near = nearly_lost(last.chain, last.state, NEAR)
    return f"{cause}. The last configuration is also near a singular one: {'; '.join(near)}" if near else str(cause)
