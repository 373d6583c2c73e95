"""The same machine code and the same bits on every processor with fma, whatever its NumPy computes with."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.processors import environment, levels, without_dispatch

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.slow

# Builds models with the library and prints digests of their parameters and code, and the bits of the answers.
SCRIPT = """
import hashlib, json
from dataclasses import replace
import numpy as np
import holdfast as hf
from holdfast.compiled.forward_schedule import forward_schedule
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.targets import batch_module, cpu
from holdfast.robots import gen3, iiwa14, panda, stewart_platform, three_finger_hand, ur5e

def digest(*texts):
    return hashlib.sha256(b"".join(texts)).hexdigest()

def bits(*arrays):
    return b"".join(np.ascontiguousarray(x).tobytes() for x in arrays).hex()

modules = []
compiled = cpu._compiled
cpu._compiled = lambda text, *more: modules.append(text) or compiled(text, *more)

random = np.random.default_rng(5)

def pose():
    x = random.uniform(-1, 1, 7)
    return np.r_[x[:4] / np.sqrt(sum(x[:4] ** 2)), x[4:]]

tool = hf.Pose.from_wxyz_xyz(pose())
makers = {"a": panda, "b": iiwa14, "c": ur5e, "d": gen3, "e": panda}
arms = {name: make(pose(), pose() if name in "ad" else tool) for name, make in makers.items()}
kinds = dict(zip(arms, ("rigid", "hinge", "softfinger", "ball", "rigid")))
box = hf.HeldObject(3.0, np.diag([0.3, 0.2, 0.4]), com=random.uniform(-1, 1, 3))
robots = hf.ClosedChain(arms, box, {name: hf.Grasp(kind, pose()) for name, kind in kinds.items()})
stewart, hand = (hf.ClosedChain(*make()) for make in (stewart_platform, three_finger_hand))
found = {}
for name, chain in (("robots", robots), ("stewart", stewart), ("hand", hand)):
    schedule = forward_schedule(Structure(chain, Options()))
    found[name] = [
        digest(batch_module(schedule, 4)[0].encode()),
        digest(*(x.tobytes() for x in parameters_of(chain, None).values())),
    ]

n = stewart.joint_count
given = {name: random.uniform(-0.05, 0.05, (3, n)) for name in ("q", "qd", "tau")}
level = hf.Pose.translation(0.0, 0.0, 0.45)
turned = {
    name: replace(leg, joints=[replace(j, placement=hf.Pose(tool.R, j.placement.p)) for j in leg.joints])
    for name, leg in stewart.arms.items()
}
fast = hf.compile(replace(stewart, arms=turned), generic_rank=36)
inputs = (*given.values(), level.wxyz_xyz, np.zeros(6))
for given in (inputs, [x[0] if np.ndim(x) == 2 else x for x in inputs]):
    result = fast.forward_dynamics(*given)
    found[f"forward {len(found)}"] = bits(result.qdd, result.grasp_wrench, result.object_acceleration)

law = hf.ControlLaw(lambda t, state, memory, given: (-0.1 * state.qd - 300.0 * state.q, memory))
rollout = hf.compile_rollout(stewart, law, scheme="midpoint")
systems = rollout.start(np.zeros((3, n)), 1e-2 * random.normal(size=(3, n)), level.wxyz_xyz, np.zeros(6))
rollout.step(systems, 1e-4, steps=3)
assert systems.running.all()
found["rollout"] = bits(*systems.arrays.values())
found["moved"] = bits(systems.q, systems.qd, systems.object_pose, systems.grasp_wrench)
found["modules"] = digest(*(text.encode() for text in modules))
print(json.dumps(found))
"""


def run(cache: Path, **setting: str) -> dict:
    """Return what a new process finds under other settings, and the names of what it leaves in a new cache."""
    env = environment(setting) | {"HOLDFAST_CACHE": str(cache), "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run([sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) | {"cache": sorted(path.name for path in cache.iterdir())}


@pytest.fixture(scope="module")
def prescott(tmp_path_factory) -> dict:
    """What OpenBLAS's oldest kernels lead to, which have no fma."""
    return run(tmp_path_factory.mktemp("prescott") / "cache", OPENBLAS_CORETYPE="Prescott")


@pytest.mark.slow
def test_other_blas(prescott, tmp_path):
    """Parameters, the text to compile, its key on disk, and every bit of the answers are those of other kernels."""
    assert run(tmp_path / "cache", OPENBLAS_CORETYPE="Haswell", **without_dispatch()) == prescott


@pytest.mark.parametrize("level", levels(fma=True))
def test_other_lanes(prescott, level, tmp_path):
    """Every bit is the same in registers of any width; each width has entries of its own on disk."""
    found = run(tmp_path / "cache", HOLDFAST_CPU=level)
    for name in prescott.keys() - {"modules", "cache"}:  # these are written for so many lanes
        assert found[name] == prescott[name], name
    assert not set(found["cache"]) & set(prescott["cache"])


@pytest.mark.parametrize("level", levels(fma=False))
def test_without_fma(prescott, level, tmp_path):
    """Products and sums are rounded apart: other last digits, the same answers."""
    found = run(tmp_path / "cache", HOLDFAST_CPU=level)
    for name in ("forward 3", "forward 4", "moved"):
        x, y = (np.frombuffer(bytes.fromhex(answers[name])) for answers in (found, prescott))
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-11 * np.abs(y).max())
    assert found["forward 3"] != prescott["forward 3"]
    assert not set(found["cache"]) & set(prescott["cache"])
