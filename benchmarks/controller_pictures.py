"""Write the pictures of the page of controllers, docs/images/controllers/*.png: what each law does, in one plot.

python benchmarks/controller_pictures.py [NAME ...]

Two Pandas hold a box of 3 kg.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.control.kit import SPRING
from tests.control.kit import STATE as FIRST
from tests.control.test_admittance_law import T as SAMPLE
from tests.control.test_admittance_law import carried, statics
from tests.control.test_admittance_law import law as admittance
from tests.control.two_pandas import LEFT, rubber_pandas, two_pandas

import holdfast as hf
from holdfast.control import (
    GravityCompensation,
    HybridForce,
    InternalForce,
    InternalImpedance,
    LoadShare,
    ObjectImpedance,
    ObjectTracking,
    PostureControl,
    RampedForces,
    RestToRest,
    cooperative_law,
    observation,
    observed,
)
from holdfast.control.commanded_forces import commanded_internal_wrenches
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, jacobian
from holdfast.forces import ForceCost, ForceLimits
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array
from holdfast.view import figure_style
from holdfast.view.figure_style import BLACK, BLUE, COLUMN, DANGER, INTERNAL_COLOUR, ORANGE

FOLDER = Path(__file__).parents[1] / "docs" / "images" / "controllers"
BOX_LIFT = Path(__file__).parents[1] / "examples" / "box_lift.toml"
K, D = np.repeat([20.0, 400.0], 3), np.repeat([8.0, 100.0], 3)
CHAIN, STATE = two_pandas()
HERE = RestToRest(STATE.object_frame)
UP = RestToRest(STATE.object_frame, displacement=[0, 0, 0.1], duration=0.5)
SOFT = ObjectImpedance(HERE, K, D)


def run_of(law: Any, duration: float, **more: Any) -> Trajectory:
    """Return a run of the two Pandas."""
    return hf.simulate(CHAIN, STATE, law, duration, 0.005, progress=False, **more)


def pushed(force: list[float], begin: float, end: float) -> Callable[[float], hf.Inputs]:
    """Return a push on the box during a time."""
    return lambda t: hf.Inputs(object_wrench=np.r_[np.zeros(3), force] if begin <= t < end else np.zeros(6))


def moved(run: Trajectory, axis: int = 6) -> Array:
    """Return the box's displacement along an axis [mm]."""
    return 1e3 * (run.object_pose[:, axis] - run.object_pose[0, axis])


def pressed(run: Trajectory) -> Array:
    """Return the internal force of each arm, (samples, arms) [N]."""
    return np.linalg.norm(run.internal_wrench[..., 3:], axis=2)


def gravity_compensation(panel: Any) -> None:
    """A push of 0.1 s moves a box that floats; dampers slow it down."""
    for damping, colour, line in ((0.0, BLUE, "-"), (1.0, ORANGE, "--")):
        law = GravityCompensation(CHAIN, joint_damping=damping)
        run = run_of(law, 1.0, inputs=pushed([0, 5.0, 0], 0.1, 0.2), breakpoints=[0.1, 0.2])
        panel.plot(run.t, moved(run, 5), line, color=colour, label=f"damping {damping:g} N m s/rad")
    panel.axvspan(0.1, 0.2, color="#dddddd", linewidth=0, label="push of 5 N")
    panel.set(xlabel="time [s]", ylabel="box moved [mm]")


def object_tracking(panel: Any) -> None:
    """The error of the path decays as the gains say, also for a box that is heavier than the law believes."""
    heavy = replace(CHAIN, held_object=hf.HeldObject.box(3.5, 0.3, 0.2, 0.2))
    for chain, colour, line, label in ((CHAIN, BLUE, "-", "box of 3 kg"), (heavy, ORANGE, "--", "box of 3.5 kg")):
        law = ObjectTracking(CHAIN, UP)
        run = hf.simulate(chain, STATE, law, 1.0, 0.005, progress=False)
        panel.plot(run.t, moved(run), line, color=colour, label=label)
    t = np.linspace(0.0, 1.0, 100)
    panel.plot(t, [1e3 * (UP.at(float(x)).pose.p[2] - UP.start.p[2]) for x in t], ":", color=BLACK, label="path")
    panel.set(xlabel="time [s]", ylabel="box lifted [mm]")


def object_impedance(panel: Any) -> None:
    """A push moves the box against a spring of 400 N/m."""
    run = run_of(
        cooperative_law(CHAIN, SOFT, InternalForce(20.0)),
        2.0,
        inputs=pushed([0, 8.0, 0], 0.1, 1.0),
        breakpoints=[0.1, 1.0],
    )
    panel.plot(run.t, moved(run, 5), color=BLUE, label="box")
    panel.axhline(1e3 * 8.0 / 400.0, color=BLACK, linestyle=":", label="8 N / (400 N/m)")
    panel.axvspan(0.1, 1.0, color="#dddddd", linewidth=0, label="push of 8 N")
    panel.set(xlabel="time [s]", ylabel="box moved [mm]")


def internal_force(panel: Any) -> None:
    """Hands press with 20 N while the box is lifted, and carry what its motion needs."""
    run = run_of(cooperative_law(CHAIN, replace(SOFT, path=UP), InternalForce(20.0)), 0.6)
    panel.plot(run.t, pressed(run)[:, 0], color=INTERNAL_COLOUR, label="internal force")
    panel.plot(run.t, run.grasp_wrench[:, 0, 5], "--", color=BLUE, label="upwards")
    panel.set(xlabel="time [s]", ylabel="force of the left hand [N]", ylim=(0, 25))


def load_share(panel: Any) -> None:
    """Given shares, and those by the strength that the drives have left, while the box moves to the right."""
    path = RestToRest(STATE.object_frame, displacement=[0.12, 0, 0], duration=1.0)
    for forces, line, label in (
        (LoadShare({"left": 0.7, "right": 0.3}), "-", "given"),
        (LoadShare(), "--", "by reserve"),
    ):
        run = run_of(cooperative_law(CHAIN, replace(SOFT, path=path), forces), 1.0)
        share = 100 * run.grasp_wrench[..., 5] / run.grasp_wrench[..., 5].sum(axis=1, keepdims=True)
        for i, colour in enumerate((BLUE, ORANGE)):
            panel.plot(run.t, share[:, i], line, color=colour, label=f"{CHAIN.names[i]}, {label}")
    panel.set(xlabel="time [s]", ylabel="share of the weight [%]", ylim=(0, 100))


def ramped_forces(panel: Any) -> None:
    """The right arm is unloaded and opens; nothing jumps."""
    forces = RampedForces(InternalForce(20.0), LoadShare({"left": 1.0}), begin=0.1, duration=0.3)
    run = run_of(cooperative_law(CHAIN, SOFT, forces), 0.7, events=[hf.Release(0.5, "right")])
    size = np.linalg.norm(run.grasp_wrench[..., 3:], axis=2)
    for i, (colour, line) in enumerate(((BLUE, "-"), (ORANGE, "--"))):
        panel.plot(run.t, size[:, i], line, color=colour, label=CHAIN.names[i])
    panel.axvline(0.5, color=BLACK, linestyle=":", label="right opens")
    panel.set(xlabel="time [s]", ylabel="force on the box [N]")


def believed(shift: float) -> hf.ClosedChain:
    """Return the chain that a law believes in, with the left grasp off by a shift along the contact's normal [m]."""
    off = hf.Pose(LEFT.R, LEFT.p + np.array([shift, 0.0, 0.0]))
    return replace(CHAIN, grasps={**CHAIN.grasps, "left": hf.Grasp("rigid", off)})


def internal_impedance(panel: Any) -> None:
    """An error of the assumed grasp presses with a force that the stiffness sets."""
    shifts = np.linspace(0.0, 0.02, 5)
    for stiffness, colour, line in ((500.0, BLUE, "-"), (2000.0, ORANGE, "--")):
        forces = []
        for shift in shifts:
            law = cooperative_law(believed(shift), SOFT, InternalImpedance(np.repeat([1.0, stiffness], 3), 10.0))
            tau, _ = law(0.0, STATE, None)
            wrench = hf.forward_dynamics(CHAIN, STATE, tau).grasp_wrench
            forces.append(np.linalg.norm(hf.forces.split(CHAIN, STATE, wrench).internal[0, 3:]))
        panel.plot(1e3 * shifts, forces, line, marker="o", markersize=3, color=colour, label=f"{stiffness:g} N/m")
    panel.set(xlabel="error of the left grasp [mm]", ylabel="internal force [N]", ylim=(0, None))


def hybrid_force(panel: Any) -> None:
    """The internal force is brought to the command, although the law does not know of 1 kg at the left hand."""
    left = CHAIN.arms["left"]
    links = (*left.links[:-1], replace(left.links[-1], mass=left.links[-1].mass + 1.0))
    real, command = replace(CHAIN, arms={**CHAIN.arms, "left": replace(left, links=links)}), InternalForce(20.0)
    for forces, colour, line, label in (
        (HybridForce(20.0, 0.005, command, sensor=real), BLUE, "-", "with the integral"),
        (command, ORANGE, "--", "without"),
    ):
        law = cooperative_law(CHAIN, replace(SOFT, stiffness=20.0 * K), forces)
        run = hf.simulate(real, STATE, law, 0.4, 0.005, sample_time=0.005, progress=False)
        asked = [commanded_internal_wrenches(law, float(t), run.state(k)) for k, t in enumerate(run.t)]
        panel.plot(run.t, np.linalg.norm(run.internal_wrench - asked, axis=2)[:, 0], line, color=colour, label=label)
    panel.set(xlabel="time [s]", ylabel="error of the force [N]", ylim=(0, None))


def posture_control(panel: Any) -> None:
    """The left elbow swings to where it shall rest, and the box does not move."""
    arm = CHAIN.arms["left"]
    *_, null = np.linalg.svd(jacobian(arm, forward_kinematics(arm, STATE.q[:7])))[2]  # moves no tip
    rest = STATE.q + np.r_[0.3 * null / np.abs(null).max(), np.zeros(7)]
    run, j = run_of(cooperative_law(CHAIN, SOFT, posture=PostureControl(rest, 5.0)), 2.0), int(np.abs(null).argmax())
    box = np.linalg.norm(1e3 * (run.object_pose[:, 4:] - STATE.object_pose[4:]), axis=1)
    panel.plot(run.t, np.degrees(run.q[:, j] - STATE.q[j]), color=BLUE, label=f"left/joint{j + 1} [degrees]")
    panel.axhline(np.degrees(rest[j] - STATE.q[j]), color=BLACK, linestyle=":", label="its rest")
    panel.plot(run.t, box, "--", color=ORANGE, label="box [mm]")
    panel.set(xlabel="time [s]", ylabel="moved")


def within_limits(panel: Any) -> None:
    """The squeeze of the scene box_lift is the least that keeps a margin of 2 N, at every moment of the lift."""
    scene = hf.load_scene(BOX_LIFT)
    run = hf.simulate(scene.chain, scene.state, scene.controller, 1.0, 0.005, progress=False)
    panel.plot(run.t, run.grasp_wrench[:, 0, 3], color=BLUE, label="squeeze")
    panel.plot(run.t, run.margin.min(axis=1), color=DANGER, label="least margin")
    panel.set(xlabel="time [s]", ylabel="force [N]", ylim=(0, None))


def fastest_path(panel: Any) -> None:
    """A path timed to be the fastest within half of the effort, beside the smooth one of least duration."""
    chain, state = rubber_pandas(0.8)
    path, limits = RestToRest(state.object_frame, displacement=[0, 0, 0.2]), ForceLimits(0.5, 2.0)
    timed = hf.time_path(chain, state, path, limits, nodes=21)
    smooth, most = replace(path, duration=timed.duration), 1.0
    while most > 0.5:
        smooth = replace(smooth, duration=1.05 * smooth.duration)
        most = max(_least_peak(chain, state, smooth, float(t)) for t in np.linspace(0.0, smooth.duration, 15))
    for one, colour, line, label in ((timed, BLUE, "-", "fastest"), (smooth, ORANGE, "--", "smooth")):
        end = one.duration
        t = np.linspace(0.0, end, 200)
        panel.plot(t, [one.at(float(x)).twist[5] for x in t], line, color=colour, label=f"{label}, {end:.2f} s")
    panel.set(xlabel="time [s]", ylabel="speed of the box [m/s]", ylim=(0, None))


def _least_peak(chain: hf.ClosedChain, state: hf.State, path: RestToRest, t: float) -> float:
    """Return the least largest share of the effort limits at one time of a path."""
    at = path.at(t)
    here = hf.close(chain, replace(state, object_pose=at.pose, object_twist=at.twist), hold_object=True)
    return hf.forces.least_peak(chain, here, at.acceleration, limits=ForceLimits(least_margin=2.0)).value


def momentum_observer(panel: Any) -> None:
    """What the observer takes for the push on the box, and the push."""
    law = observed(cooperative_law(CHAIN, SOFT), CHAIN, gain=30.0, sample_time=0.005)
    rollout = hf.compile_rollout(CHAIN, law)
    s, memory, found, push = STATE, law.memory, [], np.repeat([0.0, 8.0, 0.0], [20, 60, 40])
    times = 0.005 * np.arange(len(push))
    for t, force in zip(times, push, strict=True):
        wrench = np.r_[np.zeros(4), force, 0.0]
        systems = rollout.start(
            s.q, s.qd, s.object_pose, s.object_twist, memory=memory, t=float(t), object_wrench=wrench
        )
        rollout.step(systems, 0.005)
        s, memory = systems.state(0), systems.memory[0]
        found.append(observation(law, memory).object_wrench[4])
    panel.plot(times, push, ":", color=BLACK, label="push")
    panel.plot(times, found, color=BLUE, label="found")
    panel.set(xlabel="time [s]", ylabel="force on the box [N]")


def admittance_law(panel: Any) -> None:
    """Arms that take rates give way to a push by the law's stiffness."""
    way, times, state, memory = [], SAMPLE * np.arange(300), FIRST, None
    for t in times:
        push = np.r_[np.zeros(4), 6.0 if 0.1 <= t < 1.0 else 0.0, 0.0]
        rates, memory = admittance().given({"measured_wrenches": statics(state, push)})(float(t), state, memory)
        state = carried(state, SAMPLE * rates, SAMPLE * memory[:6])
        way.append(1e3 * (state.object_pose[5] - FIRST.object_pose[5]))
    panel.plot(times, way, color=BLUE, label="box")
    panel.axhline(1e3 * 6.0 / SPRING[4], color=BLACK, linestyle=":", label=f"6 N / ({SPRING[4]:g} N/m)")
    panel.axvspan(0.1, 1.0, color="#dddddd", linewidth=0, label="push of 6 N")
    panel.set(xlabel="time [s]", ylabel="box moved [mm]")


PICTURES = {
    draw.__name__: draw
    for draw in (
        gravity_compensation, object_tracking, object_impedance, internal_force, load_share, ramped_forces,
        internal_impedance, hybrid_force, posture_control, within_limits, fastest_path, momentum_observer,
        admittance_law,
    )
}  # fmt: skip


def print_weights() -> None:
    """Print what the weight of joint accelerations does to a box that shall stand still."""
    scene = hf.load_scene(BOX_LIFT)
    limits, still = ForceLimits(0.8, 2.0), np.zeros(6)
    most = np.array([joint.effort_limit for joint in scene.chain.all_joints])
    for weight in (0.01, 0.1, 1.0):
        cost = ForceCost(acceleration=weight)
        found = hf.forces.distribute(scene.chain, scene.state, still, limits=limits, cost=cost)
        effort, push = np.linalg.norm(found.tau / most), found.grasp_wrench[0, 3]
        print(f"weight {weight:g}: {np.abs(found.qdd).max():.2g} rad/s^2, effort {effort:.3f}, squeeze {push:.2f} N")


def main() -> None:
    """Write the pictures that are named, by default all."""
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        with figure_style.new_figure(COLUMN, 1.9) as figure:
            panel = figure.subplots()
            PICTURES[name](panel)
            figure.legend(loc="outside upper center", ncols=2, columnspacing=1.0)
        figure_style.write_figure(figure, FOLDER / f"{name}.png")
        print(FOLDER / f"{name}.png")
    if not sys.argv[1:]:
        print_weights()


if __name__ == "__main__":
    main()
