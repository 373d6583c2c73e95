"""The chain with adjusted frames in place of the model's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import row_name
from holdfast.model.joint import Joint
from holdfast.model.trunk import TRUNK
from holdfast.spatial.pose import Pose


def adjusted_chain(chain: ClosedChain, poses: Mapping[str, Pose]) -> ClosedChain:
    """Return the chain with other frames. O(n) + O(l).

    Args:
        chain: the model.
        poses: the frames that changed, by the names that `layout_of` gives them.
    """
    names = iter(chain.joint_names())

    def placed(joints: Any) -> list[Joint]:
        found = []
        for joint in joints:
            pose = poses.get(f"joint {next(names)}")
            found.append(joint if pose is None else replace(joint, placement=pose))
        return found

    trunk = chain.trunk
    if trunk is not None:
        trunk = replace(trunk, joints=placed(trunk.joints), base=poses.get(f"base {TRUNK}", trunk.base))
    arms: dict[str, Arm] = {}
    for name, arm in chain.arms.items():
        frames = {frame: (link, poses.get(f"tip {name}/{frame}", pose)) for frame, (link, pose) in arm.frames.items()}
        changes: dict[str, Any] = {"joints": placed(arm.joints), "frames": frames} if arm.joints else {}
        loops = {loop: _loop(of, f"{name}/{loop}", poses) for loop, of in arm.loops.items()}
        arms[name] = replace(
            arm,
            base=poses.get(f"base {name}", arm.base),
            tip=poses.get(f"tip {name}", arm.tip),
            **({"loops": loops} if loops else {}),
            **changes,
        )
    grasps = {}
    for key, grasp in chain.grasps.items():
        owner = row_name(key)
        frame = poses.get(f"grasp {owner}")
        grasps[key] = grasp if frame is None else replace(grasp, frame=frame)
    loops = {name: _loop(of, name, poses) for name, of in chain.loops.items()}
    return replace(chain, trunk=trunk, arms=arms, grasps=grasps, **({"loops": loops} if loops else {}))


def _loop(loop: Any, name: str, poses: Mapping[str, Pose]) -> Any:
    """Return a loop with adjusted frames."""
    frame, tip = poses.get(f"loop {name}"), poses.get(f"tip {name}")
    grasp = loop.grasp if frame is None else replace(loop.grasp, frame=frame)
    return replace(loop, grasp=grasp, tip=loop.tip if tip is None else tip)
