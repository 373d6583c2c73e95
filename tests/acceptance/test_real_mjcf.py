"""MJCF files from wheels on PyPI (`make robots`): every arm moves as in MuJoCo, or says by name what it leaves out."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from holdfast import Arm, HoldfastError
from holdfast.interop import load_mjcf
from holdfast.interop.mjcf_model import compiled_mjcf
from holdfast.interop.mjcf_tree import body_name, joint_name
from tests.acceptance.test_real_robots import FOLDER
from tests.robots.arm_dynamics import mass_jacobian_bias

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

TOLERANCE = 1e-9
WHEELS = FOLDER / "mjcf"


def ends(model) -> list[tuple[str, str]]:
    """Return base and tip of every arm from the world, or from a body that floats, to an end."""
    found = []
    for body in set(range(1, model.nbody)) - {*model.body_parentid.tolist()}:
        base, above = 0, body
        while above:
            first = model.body_jntadr[above]
            if first >= 0 and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
                base = above
                break
            above = int(model.body_parentid[above])
        if body != base:
            found.append((body_name(model, base), body_name(model, body)))
    return found


def unread(model, arm: Arm, notes: str, rng: np.random.Generator) -> dict[str, float]:
    """Return relative differences from MuJoCo; a force that the notes name is not compared."""
    data, q = mujoco.MjData(model), rng.uniform(-0.5, 0.5, arm.joint_count)
    qd = rng.uniform(-1, 1, arm.joint_count)
    numbers = {joint_name(model, j): j for j in range(model.njnt)}
    joints = [numbers[joint.name] for joint in arm.joints]
    dofs = model.jnt_dofadr[joints]
    data.qpos[:] = model.qpos0
    data.qpos[model.jnt_qposadr[joints]], data.qvel[dofs] = q, qd
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    free = bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
    ours, _, bias = mass_jacobian_bias(arm, q, qd, 0 * model.opt.gravity if free else model.opt.gravity)
    passive = -arm.damping * qd - arm.stiffness * (q - arm.rest)
    size, scale = np.abs(M[np.ix_(dofs, dofs)]).max(), max(np.abs(data.qfrc_bias[dofs]).max(), 1e-3)
    gaps = {
        "M": np.abs(ours - M[np.ix_(dofs, dofs)]).max() / size,
        "bias": np.abs(bias - data.qfrc_bias[dofs]).max() / scale,
    }
    if "fluid" not in notes and "flex" not in notes:
        gaps["passive"] = np.abs(passive - data.qfrc_passive[dofs]).max() / max(np.abs(passive).max(), 1e-3)
    if "servos" not in notes:
        gaps["actuators without control"] = np.abs(data.qfrc_actuator[dofs]).max(initial=0.0)
    return gaps


@pytest.mark.long
@pytest.mark.skipif(not any(WHEELS.rglob("*.xml")), reason="no robots fetched: make robots")
def test_real_mjcf():
    """Mass, bias, passive and actuator forces of all arms between a base and an end are those of MuJoCo, or named."""
    rng, total, worst = np.random.default_rng(0), Counter[str](), Counter[str]()
    for path in sorted(WHEELS.rglob("*.xml")):
        try:
            _, model, unknown = compiled_mjcf(path)
        except HoldfastError:
            total["files that are no model of their own"] += 1
            continue
        assert unknown == (), path
        total["files"] += 1
        for base, tip in ends(model):
            kind = compare(path, model, base, tip, rng, worst)
            total[kind] += 1
    print("; ".join(f"{count} {kind}" for kind, count in total.items()))
    print({name: f"{gap:.1e}" for name, gap in worst.items()})
    assert total["files"] >= 120
    assert total["arms"] >= 200
    assert max(worst.values()) <= TOLERANCE


def compare(path: Path, model, base: str, tip: str, rng: np.random.Generator, worst: Counter[str]) -> str:
    """Return what became of an arm, and keep its differences from MuJoCo."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            arm = load_mjcf(path, base=base, tip=tip, lock_others=True)
        except HoldfastError as refusal:
            return "refused: " + re.sub(r"'[^']*'|\S*/", "*", str(refusal))[-70:]
    assert len(caught) <= 1, path
    for name, gap in unread(model, arm, "".join(arm.notes), rng).items():
        assert gap <= TOLERANCE, (path, base, tip, name, gap)
        worst[name] = max(worst[name], gap)
    return "arms"
