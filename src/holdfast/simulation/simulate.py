"""Simulation of a closed chain with a controller; every sample satisfies the grasp constraint."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast import outer
from holdfast.control.clipped import clipped
from holdfast.control.compiled_law import CompiledLaws
from holdfast.control.controller import (
    ControlLaw,
    Controller,
    GivenLaw,
    controller_of,
    given_law,
    known_breakpoints,
    machine_code,
)
from holdfast.control.traced_law import require_function
from holdfast.dynamics.tree.forest_inverse import inverse_code
from holdfast.errors import ModelError, StateError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused, serial_chain
from holdfast.progress import of_time, reporting
from holdfast.simulation.adaptive import RTOL, Tolerance
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.contact_events import EVENTS_WAY, IMPULSES_WAY, require_contacts
from holdfast.simulation.environment import BaseMotion, Environment, GivenInputs
from holdfast.simulation.events import Event, in_order
from holdfast.simulation.hand_events import SLIDE, require_slidable
from holdfast.simulation.margins import OnLimit, OnSingular, OnSlip, Policy
from holdfast.simulation.mechanism_segment import MechanismSegment, attached_later, require_openable
from holdfast.simulation.rollout.compiled_impulses import impulse_stepper_for
from holdfast.simulation.rollout.compiled_steppers import stepper_for
from holdfast.simulation.rollout.mechanism_steppers import MechanismSteppers
from holdfast.simulation.rollout.open_contacts import ContactSteppers
from holdfast.simulation.run import recorded_run, resumed_run, start_of_run
from holdfast.simulation.run_record import EVERYTHING, Listeners, record_settings, require_memory
from holdfast.simulation.runge_kutta import scheme as scheme_named
from holdfast.simulation.segment import MakeStepper, RunSettings
from holdfast.simulation.setting import Setting, recorded_base
from holdfast.simulation.stops import ALIKE, step_times, stops
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import EVALUATIONS
from holdfast.simulation.zero_order_hold import at_samples, zero_order_hold
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

CALLS_WORTH_COMPILING = 250  # evaluations: compiling a law takes as long as about as many without machine code


@np.errstate(all="ignore")  # a run that diverges ends in a StateError, not in warnings
def simulate(
    chain: ClosedChain,
    state: State,
    controller: Controller | ControlLaw | None,
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
    contacts: str | None = None,
    scheme: str = "rk4",
    rtol: float = RTOL,
    atol: float | None = None,
    largest_drift: float | None = None,
    record: str | Sequence[str] = EVERYTHING,
    every: int = 1,
    start: Checkpoint | None = None,
    progress: bool | Callable[[float], object] | None = None,
    on_sample: Callable[[Trajectory], None] | None = None,
    on_checkpoint: Callable[[Checkpoint], None] | None = None,
    on_samples: Callable[[Trajectory, Checkpoint], None] | None = None,
    make_stepper: MakeStepper | None = None,
    name: str = "run",
    folder: str | PathLike[str] | None = None,
    overwrite: bool = False,
) -> Trajectory:
    """Return the motion from an initial state, by Runge-Kutta steps with projection and verified contacts.

    The run ends early if a step reaches a singular configuration, cannot be projected onto the grasps or is not finite,
    or if a grasp slips (see `on_slip`). The samples up to then are returned, and `stopped` gives the reason and time.
    The margins of one-sided grasps and of joint limits are also evaluated inside every step; `simulation.verification`
    states which violations are certain to be found. For a chain without such limits this costs nothing.

    A chain with branches, loops, couplings or several objects is simulated by the same schemes but "imex", with bases
    that stand. The margins of its joints, grasps and loops, by the smallest forces if these are not unique, are
    evaluated inside steps as those of serial chains; where a controller is called at every stage, or wrenches are a
    function, first on interpolated instants, and by shorter steps where a violation may begin or end. Singular
    configurations end a run only where no accelerations exist.

    Args:
        chain: arms, object and grasps.
        state: initial state, which must satisfy the grasps.
        controller: function (t, state, memory) -> (torques (n,), memory); the memory is None in the first call. The
            optional attribute `breakpoints` lists the times at which its torques jump. The optional method
            `for_chain(chain)` returns the controller to use after a grasp has closed or opened. None for a chain
            without joints.
        duration: duration of the run [s].
        step: step h [s]; the last step is shorter if h does not divide the duration. An adaptive scheme takes shorter
            steps if necessary, none of them across a multiple of h. Every step ends with a sample.
        base_motion: functions t -> (pose, twist, acceleration) of moving bases, by arm name, or "trunk" for that of a
            trunk.
        inputs: external wrenches: constant, a function of t, or a function of (t, state). A function counts as one of
            (t, state) if it cannot be called with t alone; it is evaluated at every stage and may return wrenches only.
        events: `Attach` and `Release` at given times.
        breakpoints: times at which torques or inputs, or their slopes, jump; steps end there.
        parameters: values of a `ControlLaw`'s parameters, by name; other controllers have none.
        sample_time: sample time of a digital controller [s]. The controller is then called once per sample with the
            state at that time, and its torques are held until the next sample (zero-order hold). Steps end at samples.
            None: the controller is evaluated at every stage, unless it is a law that `control.sampled` returned.
        delay: time from a sample until its torques act [s]. Until then the previous torques act, and at the start
            those of the first sample.
        on_slip: what to do when a grasp cannot hold: "stop"; "record" and continue as if the grasp held;
            "release", which opens the grasp and keeps the velocities; or "slide": a hand that holds by friction slides
            on the plane of its grasp with Coulomb's friction, holds again where it stops, and is released where it
            lifts. Its row of `grasp_wrench` is then the wrench about the tip's origin, and `holding` is false.
        on_limit: what to do when a joint exceeds a limit: "record"; "stop"; or "clip", which clips torques to the
            effort limits (the margin is then 0) and records the other limits.
        on_singular: what to do at a singular configuration: "stop" before it, or "continue" through it if exactly one
            motion with continuous velocities leads through. Steps then end near it.
        contacts: how contacts with the world are followed, if the chain has `touching`: "events", the default: in fixed
            modes (open, sticks, slips) with the order of the scheme, from one located change to the next; "steps": by
            impulses over fixed steps of the midpoint rule, whatever the scheme, of first order across a touch.
        scheme: "rk4", "midpoint", "dop853" (adaptive, order 8) or "imex" (linearly implicit in joint dampers and
            springs).
        rtol: relative tolerance of an adaptive scheme, see `adaptive.Tolerance`.
        atol: absolute tolerance of an adaptive scheme.
        largest_drift: largest position gap that a fixed step may leave before projection, for example 1e-10; a step
            with a larger gap is divided into equal parts [m or rad]. None: steps are not divided.
        record: what is recorded: "everything"; "states", which are positions, velocities and accelerations; or names of
            a trajectory's arrays. The others raise an error when they are used. What is verified stays the same.
        every: number of steps between two samples. Both sides of an event, of a jump at such a step, and the last
            sample are recorded, too. Lowest margins are those since the sample before.
        start: checkpoint from which to continue; `state` is then not used, and only the later samples are returned.
        progress: True to show a progress bar, in a notebook or on a terminal; or a function that is called with the
            time after a step, or after several that were taken together.
        on_sample: called with every recorded sample; samples of up to 256 steps come one after another.
        on_checkpoint: called after `on_sample` with a checkpoint from which the run can be continued.
        on_samples: called with the samples of one or more steps as a run, and the checkpoint after the last of them, to
            which what has happened belongs.
        make_stepper: returns the stepper. By default steps are compiled to machine code if there are enough of them.
        name: name of the run in pages and files.
        folder: result folder to which the samples are appended while the run goes on, at least every 5 seconds. It can
            be read at any time by `load_result`, also after the process was killed. Memory holds at most 256 MiB of
            samples beside it; the arrays of a longer run are read from the folder when they are first used.
        overwrite: whether an earlier result in this folder is replaced.

    Returns:
        A `Trajectory`.

    Raises:
        ModelError: the duration or step is not positive, there are too many steps, a policy, a scheme or an array is
            unknown, an event is impossible, the sample time or delay is invalid, the controller is not a function, or a
            law depends on more than its arguments.
        StateError: the initial state violates a grasp, the controller does not return valid torques and memory, or
            the parameters do not match those of its law.
        SingularChainError: the initial configuration is singular.
        ResultError: the folder is in use or cannot be written.
        MethodNotApplicable: the chain is answered as a forest, and does not take one of the arguments, or a loop would
            have to be released.
    """
    forest = answered_as_forest(chain)
    if forest:
        require_unused(base_motion=bool(base_motion), make_stepper=make_stepper is not None)
        require_unused(on_singular=on_singular != "stop", scheme=scheme == "imex")
    else:
        serial_chain(chain, "simulation: chain")
    checks.instance(state, State, "simulation: state", StateError)
    driver = controller_of(chain.joint_count, controller)
    checks.name(name, "simulation: name")
    named = scheme_named(scheme)
    if on_slip == SLIDE:
        require_slidable(chain, bool(base_motion), contacts, named.adaptive)
    unsupported = {"make_stepper": make_stepper, "largest_drift": largest_drift}
    require_contacts(chain, contacts, named, on_singular, [what for what, x in unsupported.items() if x is not None])
    grid = step_times(duration, step)
    state.fits(chain)
    ordered = in_order(events, chain, float(grid[-1]))
    if not checks.is_listed(breakpoints):
        raise ModelError(f"simulation: breakpoints: expected times, got {checks.short(breakpoints)}")
    jumps = checks.vector([*breakpoints], "simulation: breakpoints").tolist()
    happening = [one.t for one in ordered]
    driver, sample_time, delay = at_samples(driver, sample_time, delay)
    hold = zero_order_hold(sample_time, delay, float(grid[-1]), [*jumps, *happening])
    if hold is None:
        ends = stops(grid, [*jumps, *known_breakpoints(driver)], happening, ALIKE * step)
    else:
        ends = stops(grid, [*jumps, *hold.jumps], happening, ALIKE * step, hold.asked.tolist())
    environment = Environment(chain, {} if base_motion is None else base_motion, Inputs() if inputs is None else inputs)
    policy, tolerance = Policy(on_slip, on_limit, on_singular), Tolerance(rtol, atol)
    steps = int((~ends.jumps).sum())
    of_forest = MechanismSteppers(steps) if forest else None
    make = make_stepper or of_forest or partial(stepper_for, steps=steps)
    wanted = record_settings(record, every, step, chain)
    if folder is None:
        require_memory(len(grid), wanted.every)
    limit = None if largest_drift is None else checks.number(largest_drift, "simulation: largest_drift", above=0.0)
    if policy.on_limit == "clip":
        driver = clipped(driver, chain)
    acting = given_law(driver, parameters)
    if isinstance(acting, GivenLaw):
        require_function(acting.law, chain)
    if forest:
        require_openable(chain, policy)
    settings = RunSettings(environment, acting, hold, make, named, tolerance, limit, policy, ordered, ends, wanted)
    by_impulses = contacts == IMPULSES_WAY
    make_contacts = partial(impulse_stepper_for, steps=steps) if by_impulses else ContactSteppers(steps)
    settings = replace(settings, by_impulses=by_impulses, make_contacts=make_contacts)
    settings = replace(settings, make_segment=MechanismSegment) if forest else settings

    verified = EVALUATIONS if joint_limits(chain).limited.any() else 1
    calls = 0 if forest or chain.touching is not None else len(ends.times) * (1 if hold else len(named.c) * verified)
    options = {"scheme": scheme, "on_slip": on_slip, "on_limit": on_limit, "on_singular": on_singular, "rtol": rtol}
    called = getattr(driver, "__qualname__", type(driver).__qualname__)
    options |= {} if chain.touching is None else {"contacts": contacts or EVENTS_WAY}
    options |= {"atol": atol, "largest_drift": limit, "controller": called}
    options |= {} if not parameters else {"parameters": {name: x.tolist() for name, x in acting.values.items()}}
    options |= wanted.options | ({} if hold is None else {"sample_time": hold.sample_time, "delay": hold.delay})
    attached = attached_later(ordered) if forest else []
    options |= {"attached": attached} if attached else {}
    setting = Setting(chain, environment.base_motion, name, float(duration), float(step), options)
    doing, begin = f"simulating {name}", f"{duration:g} s in {len(grid) - 1} steps"
    with (
        laws_by_machine_code(chain, calls, of_forest),
        reporting(progress, doing, begin, of_time(duration)) as tell,
        _appending(folder, overwrite, setting, ends.times) as on_disk,
    ):
        told = [one for one in (None if on_disk is None else on_disk.add, on_samples) if one is not None]
        read = None if on_disk is None else on_disk.read
        listeners = Listeners(tell, on_sample, on_checkpoint, told, read)
        at = start_of_run(settings, state) if start is None else resumed_run(settings, start)
        run = recorded_run(at, start is not None, listeners)
        moved = {base: recorded_base(base, motion, run.t) for base, motion in environment.base_motion.items()}
        run = changed(run, setting=replace(setting, base_motion=moved))
        if on_disk is not None:
            on_disk.finish(run)
    return run


@contextmanager
def _appending(folder: str | PathLike[str] | None, overwrite: bool, setting: Setting, times: Array) -> Iterator[Any]:
    """Within this context, append samples to a folder, if there is one; what waits is written at an error, too."""
    if folder is None:
        yield None
        return
    saved = outer.AppendedRun(folder, setting, times, overwrite)
    try:
        yield saved
    except BaseException:
        saved.interrupt()
        raise


@contextmanager
def laws_by_machine_code(chain: ClosedChain, calls: int, of_forest: MechanismSteppers | None = None) -> Iterator[None]:
    """Within this context, evaluate the library's controllers and control laws with machine code if it is worthwhile.

    Args:
        chain: the chain that they control.
        calls: approximate number of evaluations.
        of_forest: the steppers of a run of a chain that is answered as a forest.
    """
    token = machine_code.set(CompiledLaws(chain) if calls >= CALLS_WORTH_COMPILING else None)
    of_inverse = inverse_code.set(None if of_forest is None else of_forest.inverse)
    try:
        yield
    finally:
        inverse_code.reset(of_inverse)
        machine_code.reset(token)
