"""kill -9 at any moment of a run with contacts, and `--resume`: every bit, and the log, as if nothing had happened."""

import os
import signal
import subprocess
import sys
import textwrap

import pytest

import holdfast as hf
from holdfast.cli import main
from tests.io.recorded import same_bits

SLIDES = """
    arms = []
    simulation = {{ duration = {duration}, step = 0.01, contacts = "{contacts}" }}
    world = [{{ name = "table", type = "half_space", friction = 0.3 }}]

    [object]
    mass = 2.0
    box = [0.2, 0.2, 0.1]
    pose = {{ position = [0, 0, {height}], quaternion = {quaternion} }}
    twist = {twist}
    touching = {{ {points} }}
"""
JAWS = """
    gravity = [0, 0, -9.81]
    simulation = { duration = 0.6, step = 0.05, on_slip = "slide" }

    [object]
    mass = 1.5
    box = [0.1, 0.1, 0.1]

    [[arms]]
    name = "left"
    base = { position = [-0.05, 0, 0] }
    tip = { quaternion = [0.5, -0.5, 0.5, -0.5] }
    joints = [{ kind = "prismatic", axis = [1, 0, 0], link = { mass = 0.4, box = [0.04, 0.04, 0.04] } }]

    [[arms]]
    name = "right"
    base = { position = [0.05, 0, 0] }
    tip = { quaternion = [0.5, -0.5, -0.5, 0.5] }
    joints = [{ kind = "prismatic", axis = [1, 0, 0], link = { mass = 0.4, box = [0.04, 0.04, 0.04] } }]

    [[grasps]]
    arm = "left"
    kind = "softfinger"
    position = [-0.05, 0, 0]
    quaternion = [0.5, -0.5, 0.5, -0.5]
    contact = { mu = 0.4, torsion_radius = 0.01 }

    [[grasps]]
    arm = "right"
    kind = "softfinger"
    position = [0.05, 0, 0]
    quaternion = [0.5, -0.5, -0.5, 0.5]
    contact = { mu = 0.4, torsion_radius = 0.01 }

    [controller]
    type = "torque_schedule"
    pieces = [
      { begin = 0.0, torques = [[30.0, -40.0], [-30.0, 40.0]] },
      { begin = 0.45, torques = [[35.0], [-35.0]] },
    ]
"""
TURNED = [0.8, 0.0, 0.6, 0.0]
FEET = "points = { a = [0.05, 0, -0.05], b = [-0.05, 0.05, -0.05], c = [-0.05, -0.05, -0.05] }"
SCENES = {
    "steps": SLIDES.format(contacts="steps", duration=0.16, height=0.13, quaternion=TURNED, points='points = "corners"',
                           twist=[0, 0, 0.5, 0.6, 0.2, -0.3]),
    "events": SLIDES.format(contacts="events", duration=0.16, height=0.05, quaternion=[1, 0, 0, 0],
                            points=FEET, twist=[0, 0, 0, 0.3, 0, 0]),
    "hands": JAWS,
}  # fmt: skip
SEEN = {"steps": "touch", "events": "stick", "hands": "slip"}
# flushes every other sample, and kills itself as it puts its n-th file in place
PROGRAM = """
    import os, signal, sys
    from holdfast.cli import main
    from holdfast.io import result_folder

    result_folder.CHUNK, result_folder.LONGEST_WAIT = 2, float("inf")
    left, put = int(sys.argv[1]), os.replace

    def counted(*of):
        global left
        left -= 1
        if not left:
            os.kill(os.getpid(), signal.SIGKILL)
        put(*of)

    os.replace = counted
    main(sys.argv[2:])
"""


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_killed_and_resumed(name, tmp_path, monkeypatch):
    """Killed three times in one run: while the contacts change, and in the middle of writing."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(textwrap.dedent(SCENES[name]))
    assert main(["simulate", "scene.toml", "--out", "whole", "--no-plots"]) == 0
    whole = hf.load_result("whole").trajectory
    assert whole.stopped is None and SEEN[name] in {one.kind for one in whole.occurrences}
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    samples, more = [], []
    for files in (6, 7, 8):
        program = [sys.executable, "-c", textwrap.dedent(PROGRAM), str(files)]
        program += ["simulate", "scene.toml", "--out", "run", "--no-plots", *more]
        one = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
        assert one.returncode == -signal.SIGKILL, one.stderr
        found, more = hf.load_result("run"), ["--resume"]
        assert not found.complete
        samples.append(found.samples)
    assert 0 < samples[0] <= samples[1] <= samples[2] < len(whole) and samples[0] < samples[2]
    assert main(["simulate", "scene.toml", "--out", "run", "--no-plots", "--resume"]) == 0
    same_bits(hf.load_result("run").trajectory, whole)
