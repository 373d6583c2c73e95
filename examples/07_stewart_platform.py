"""A Stewart platform that tilts: six legs, none of which could carry the platform alone, and the actuator forces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.robots import stewart_platform
from holdfast.view.figure_style import DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"
MIRRORED = ((0, 1), (2, 5), (3, 4))  # legs that mirror each other in the plane of the tilt


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    # Every leg is an arm of two passive joints and a drive; balls join the legs to the 20 kg platform.
    platform = stewart_platform(payload=20.0)
    chain, level = hf.assemble(*platform)
    passive = [name for name in chain.joint_names() if not name.endswith("drive")]
    drives = np.array([name.endswith("drive") for name in chain.joint_names()])

    # Tilt it about the y axis, standing still at every angle; each pose is closed from the one before.
    angles = np.deg2rad(np.linspace(-15, 15, 11))
    forces, loads, residuals, state = [], [], [], level
    for angle in [0.5 * angles[0], *angles]:  # half way first
        pose = [np.cos(angle / 2), 0, np.sin(angle / 2), 0, *level.object_pose[4:]]
        state = hf.close(chain, hf.State(state.q, state.qd, pose), hold_object=True)
        tau = hf.holding_torques(chain, state, passive=passive)
        result = hf.forward_dynamics(chain, state, tau)
        forces.append(tau[drives])
        loads.append(result.grasp_wrench[:, 3:].sum(axis=0))
        residuals.append(np.abs(np.r_[result.qdd, result.object_acceleration, tau[~drives]]).max())
    force, load = np.array(forces[1:]), np.array(loads[1:])

    # Virtual work: at the level pose, raising everything by dz costs its weight times the height.
    rise = 1e-4
    heights = [level.object_pose + np.r_[np.zeros(6), z] for z in (-rise, rise)]
    near = [hf.close(chain, hf.State(level.q, level.qd, pose), hold_object=True) for pose in heights]
    work = force[len(angles) // 2] @ (near[1].q - near[0].q)[drives]
    energy = hf.dynamics.potential_energy(chain, near[1]) - hf.dynamics.potential_energy(chain, near[0])

    draw(out, np.rad2deg(angles), force)
    diagnosis = hf.diagnose(chain, level)
    print(diagnosis.report())
    print(f"force of every actuator when level: {force[len(angles) // 2, 0]:.2f} N; most: {force.max():.2f} N")
    print(f"nothing moves: largest acceleration and passive torque {max(residuals):.1e}")
    return {
        "mobility": diagnosis.mobility,
        "residual": float(max(residuals)),
        "weight": float(-platform.held_object.mass * chain.gravity[2]),
        "load_error": float(np.abs(load + platform.held_object.mass * chain.gravity).max()),
        "virtual_work": float(work),
        "potential": float(energy),
        "mirrored": float(max(np.abs(force[:, a] - force[:, b]).max() for a, b in MIRRORED)),
        "spread_level": float(np.ptp(force[len(angles) // 2])),
        "largest": float(force.max()),
    }


def draw(out: Path, angles: np.ndarray, forces: np.ndarray) -> None:
    """Draw the drives' forces over the angle of tilt."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        for k, (one, other) in enumerate(MIRRORED):
            colour, line = arm_style(k)
            axes.plot(angles, forces[:, one], linestyle=line, color=colour, label=f"leg {one + 1}")
            axes.plot(angles, forces[:, other], "o", color=colour, fillstyle="none", label=f"leg {other + 1}")
        axes.set(xlabel="tilt about y [degrees]", ylabel="force of the drive [N]")
        figure.legend(loc="outside upper center", ncols=6, columnspacing=1.0)
        out.mkdir(parents=True, exist_ok=True)
        figure.savefig(out / "07_stewart_platform.png", dpi=DPI)


if __name__ == "__main__":
    main()
