"""Arms with branches out of MJCF: fingers, ball joints, loops and couplings, as MuJoCo's own matrices have them."""

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import HoldfastError, SceneError
from holdfast.interop import load_mjcf

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install mujoco-core")

GRIPPER = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="column" pos="0.1 0 0.2" euler="0.1 0.2 0.3">
      <joint name="turn" axis="0 0 1" pos="0.02 0 0" armature="0.1"/>
      <geom type="box" size="0.05 0.05 0.2" mass="2"/>
      <body name="palm" pos="0 0.1 0.3">
        <joint name="wrist" type="ball" pos="0.01 0 0" damping="0"/>
        <geom type="box" size="0.05 0.1 0.02" mass="1"/>
        <site name="grip" pos="0 0 0.1"/>
        <body name="crank" pos="0 0.06 0.02">
          <joint name="crank" axis="1 0 0"/>
          <geom type="capsule" size="0.01" fromto="0 0 0 0 0.01 0.08" mass="0.2"/>
          <body name="coupler" pos="0 0.01 0.08">
            <joint name="coupler" axis="1 0 0"/>
            <geom type="capsule" size="0.01" fromto="0 0 0 0 -0.05 0" mass="0.1"/>
          </body>
        </body>
        <body name="rocker" pos="0 0.01 0.02">
          <joint name="rocker" axis="1 0 0"/>
          <geom type="capsule" size="0.01" fromto="0 0 0 0 0.01 0.08" mass="0.2"/>
        </body>
        <body name="finger1" pos="0 -0.05 0.02">
          <joint name="finger1" type="slide" axis="0 1 0" ref="0.01" range="0 0.05"/>
          <geom type="box" size="0.01 0.01 0.04" mass="0.1"/>
        </body>
        <body name="finger2" pos="0 -0.08 0.02">
          <joint name="finger2" type="slide" axis="0 -1 0" range="0 0.05"/>
          <geom type="box" size="0.01 0.01 0.04" mass="0.1"/>
        </body>
      </body>
    </body>
    <body name="spring" pos="0.5 0 0">
      <joint name="lever" axis="0 1 0"/>
      <geom type="box" size="0.1 0.01 0.01" mass="0.3"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="crank" coef="0.5"/><joint joint="finger2" coef="2"/></fixed>
  </tendon>
  <equality>
    <connect name="four_bar" body1="coupler" body2="rocker" anchor="0 -0.05 0"/>
    <joint name="mimic" joint1="finger1" joint2="finger2" polycoef="0.01 0.8 0 0 0"/>
    <tendon name="tied" tendon1="both" polycoef="0 0 0 0 0"/>
  </equality>
</mujoco>
"""


CLOSED = 0.02  # of the first finger, where the second one is at 0: its reference and what the polynomial adds [m]


def oracle(text: str, tau: np.ndarray) -> tuple[object, np.ndarray]:
    """Return MuJoCo's model and accelerations at rest by its mass matrix, bias and equalities."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.joint("finger1").qpos[:] = CLOSED
    mujoco.mj_forward(model, data)
    M, J = np.zeros((model.nv, model.nv)), np.zeros((data.nefc, model.nv))
    for k, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, M[k], unit)
    J = data.efc_J.reshape(data.nefc, model.nv)[data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)]
    system = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
    right = np.concatenate([tau - data.qfrc_bias, np.zeros(len(J))])
    return model, np.linalg.lstsq(system, right, rcond=1e-12)[0][: model.nv]


def test_everything_beyond_the_base():
    """Accelerations at rest are those of MuJoCo's matrices, a ball's in the axes of its frame on the parent."""
    random = np.random.default_rng(0)
    tau = random.normal(size=10)
    model, expected = oracle(GRIPPER, tau)
    arm = load_mjcf(GRIPPER, branches=True)
    names = [joint.name for joint in arm.joints]
    assert names[0] == "turn" and {*arm.loops} == {"four_bar"} and len(arm.couplings) == 2
    assert {"grip", "palm", "crank"} <= set(arm.frames)
    chain = hf.ClosedChain({"arm": arm})
    q, qdd, own = [], [], []
    for joint in arm.joints:
        j = model.joint(joint.name)
        at, start = int(j.dofadr[0]), int(j.qposadr[0])
        at_rest = model.qpos0[start : start + joint.type.position_count].tolist()
        q += [CLOSED] if joint.name == "finger1" else at_rest
        own += tau[at : at + joint.type.freedoms].tolist()
        qdd += expected[at : at + joint.type.freedoms].tolist()
    found = hf.forward_dynamics(chain, hf.State(q, np.zeros(10)), own)
    np.testing.assert_allclose(found.qdd, qdd, rtol=1e-9, atol=1e-9)
    assert found.mobility == 10 - 2 - 2  # of three rows of the connect two act in the plane of the four-bar


def test_along_a_path():
    """With a tip, what hangs on the path belongs to the arm and what hangs on the base does not; locks hold."""
    alone = GRIPPER.replace('<tendon name="tied" tendon1="both" polycoef="0 0 0 0 0"/>', "")
    held = {"crank": 0.0, "coupler": 0.0, "rocker": 0.0}
    arm = load_mjcf(alone, tip="grip", branches=True, locked=held)
    assert [joint.name for joint in arm.joints] == ["turn", "wrist", "finger1", "finger2"]
    assert arm.parents == (None, 0, 1, 1) and not arm.loops and len(arm.couplings) == 1
    (mimic,) = arm.couplings
    assert dict(mimic.terms) == {"finger1": 1.0, "finger2": -0.8}
    assert mimic.offset == pytest.approx(0.02)
    with pytest.raises(SceneError, match="joint 'wrist': expected a hinge or a slide"):
        load_mjcf(alone, tip="grip", lock_others=True)
    with pytest.raises(SceneError, match="'tied': expected joints of the arm that move, got 'crank'"):
        load_mjcf(GRIPPER, tip="grip", branches=True, locked=held)


def test_a_weld_to_the_base():
    """A weld becomes a rigid closure with what stands still, at the model's relative pose."""
    (mimic,) = [line for line in GRIPPER.splitlines() if "mimic" in line]
    weld = '<weld name="fixed" body1="finger1" body2="world"/>'
    text = GRIPPER.replace(mimic, weld)
    arm = load_mjcf(text, branches=True)
    loop = arm.loops["fixed"]
    assert loop.a is None and loop.b == "finger1" and loop.grasp.kind == "rigid"
    chain = hf.ClosedChain({"arm": arm})
    q = np.concatenate(
        [[1.0, 0.0, 0.0, 0.0] if joint.type.quaternion else [0.01 * (joint.name == "finger1")] for joint in arm.joints]
    )
    held = hf.forward_dynamics(chain, hf.State(q, np.zeros(10)), np.zeros(10))
    np.testing.assert_allclose(held.qdd[:4], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("0.01 0.8 0 0 0", "0.01 0.8 0.5 0 0", "'mimic': polycoef: expected the first degree, got 0.01 0.8 0.5 0 0"),
        (
            '<joint name="mimic" joint1="finger1" joint2="finger2" polycoef="0.01 0.8 0 0 0"/>',
            '<joint name="mimic" joint1="finger1" joint2="lever"/>',
            "'mimic': expected joints of the arm that move, got 'lever'",
        ),
        (
            '<joint name="mimic" joint1="finger1" joint2="finger2" polycoef="0.01 0.8 0 0 0"/>',
            '<connect body1="finger1" body2="lever" anchor="0 0 0"/>',
            None,
        ),
    ],
)
def test_refusals(was, now, message):
    """What the model cannot have is refused by name; what ties the arm to another object is no matter of the arm."""
    if message is None:
        text = GRIPPER.replace(was, now).replace('lever" anchor', 'spring" anchor')
        assert [*load_mjcf(text, tip="grip", branches=True).loops] == ["four_bar"]
        return
    with pytest.raises(SceneError, match=message):
        load_mjcf(GRIPPER.replace(was, now), tip="grip", branches=True)


BEYOND = {
    "not a number": ('damping="0"', 'damping="nan"', "expected numbers, got NaN in an attribute"),
    "a coupling": ("0.01 0.8 0 0 0", "0.01 inf 0 0 0", "expected finite numbers"),
    "an inertia": ('size="0.05 0.1 0.02"', 'size="0.05 inf 0.02"', "expected finite numbers"),
}


@pytest.mark.parametrize("what", BEYOND)
def test_numbers_beyond_all(what, tmp_path, monkeypatch, capfd):
    """They are refused without a warning; MuJoCo says nothing on the screen and writes no file of its own."""
    monkeypatch.chdir(tmp_path)
    was, now, message = BEYOND[what]
    assert was in GRIPPER
    with pytest.raises(HoldfastError, match=message):
        load_mjcf(GRIPPER.replace(was, now, 1), branches=True)
    assert capfd.readouterr() == ("", "") and not [*tmp_path.iterdir()]
