"""Your own robot, from a URDF file: two of them hold a box; each torque as a share of its limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import holdfast as hf
from holdfast.view.figure_style import DANGER, DPI, STYLE, arm_style

OUT = Path(__file__).parent / "out"

# name, axis, height on the link before [m]; length along z [m], mass [kg]; strength [N m]
JOINTS = (
    ("waist", "0 0 1", 0.0, 0.20, 3.0, 80),
    ("shoulder", "0 1 0", 0.20, 0.40, 4.0, 80),
    ("elbow", "0 1 0", 0.40, 0.36, 2.5, 40),
    ("roll", "0 0 1", 0.36, 0.06, 1.0, 20),
    ("bend", "0 1 0", 0.06, 0.06, 0.8, 20),
    ("flange", "0 0 1", 0.06, 0.05, 0.3, 10),
)


def urdf() -> str:
    """Return the robot's description: links that are solid cylinders, one on the other. Yours comes from CAD."""
    parts, parent = ['<robot name="mine"> <link name="base"/>'], "base"
    for name, axis, at, length, mass, effort in JOINTS:
        across, along = mass * (3 * 0.05**2 + length**2) / 12, mass * 0.05**2 / 2
        parts.append(f"""
  <joint name="{name}" type="revolute">
    <parent link="{parent}"/> <child link="{name}_link"/> <origin xyz="0 0 {at}"/> <axis xyz="{axis}"/>
    <limit lower="-2.6" upper="2.6" velocity="3" effort="{effort}"/>
  </joint>
  <link name="{name}_link"> <inertial> <origin xyz="0 0 {length / 2}"/> <mass value="{mass}"/>
    <inertia ixx="{across}" iyy="{across}" izz="{along}" ixy="0" ixz="0" iyz="0"/> </inertial> </link>""")
        parent = f"{name}_link"
    parts.append(f"""
  <joint name="mount" type="fixed"> <parent link="{parent}"/> <child link="tip"/> <origin xyz="0 0 0.05"/> </joint>
  <link name="tip"/> </robot>""")
    return "".join(parts)


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "mine.urdf"
    file.write_text(urdf())
    arms = {  # where each is mounted: quaternion wxyz, then position
        "left": hf.load_urdf(file, mount=[1, 0, 0, 0, -0.6, 0, 0]),
        "right": hf.load_urdf(file, mount=[0, 0, 0, 1, 0.6, 0, 0]),
    }
    box = hf.HeldObject.box(mass=4.0, x=0.3, y=0.2, z=0.2)
    grasps = {
        "left": hf.Grasp("rigid", hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0])),
        "right": hf.Grasp("rigid", hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0])),
    }
    assembly = hf.assemble(arms, box, grasps, object_pose=[1, 0, 0, 0, 0, 0, 0.5])
    chain, state = assembly
    tau = hf.holding_torques(chain, state, internal_force=15.0)
    result = hf.forward_dynamics(chain, state, tau)
    use = tau / [joint.effort_limit for arm in chain.arms.values() for joint in arm.joints]
    draw(out, chain, use)

    print(assembly.report)
    for name in chain.names:
        print(f"force at the {name} hand: {np.round(result[name].grasp_wrench[3:], 2) + 0.0} N")
    print(f"nearest to its torque limit: {chain.joint_names()[np.abs(use).argmax()]}, at {np.abs(use).max():.0%}")
    return {
        "mass": sum(link.mass for link in arms["left"].links),
        "left_up": float(result["left"].grasp_wrench[5]),
        "internal_force": float(result["left"].grasp_wrench[3]),
        "acceleration": float(np.abs(np.r_[result.qdd, result.object_acceleration]).max()),
        "force_error": float(np.abs(result.grasp_wrench[:, 3:].sum(axis=0) + box.mass * chain.gravity).max()),
        "base_load": float(result.base_wrench[:, 5].sum()),
        "use": float(np.abs(use).max()),
    }


def draw(out: Path, chain: hf.ClosedChain, use: np.ndarray) -> None:
    """Draw every drive's torque as part of its limit."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.5, 2.8), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(JOINTS))
        for k, (name, part) in enumerate(chain.joints.items()):
            axes.bar(places + 0.4 * k - 0.2, 100 * np.abs(use[part]), 0.38, color=arm_style(k)[0], label=name)
        axes.set_axisbelow(True)
        axes.axhline(100, color=DANGER, linewidth=0.8)
        axes.set(xticks=places, xticklabels=[joint[0] for joint in JOINTS], ylabel="torque to hold it [% of the limit]")
        figure.legend(loc="outside upper center", ncols=2)
        figure.savefig(out / "10_your_own_robot.png", dpi=DPI)


if __name__ == "__main__":
    main()
