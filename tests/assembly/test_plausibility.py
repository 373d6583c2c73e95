"""Numbers that are possible but unlikely are noted with their likely cause; what is usual is not."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import holdfast as hf
from holdfast.assembly.plausibility import outward_normal, plausibility_notes
from holdfast.cli import main
from holdfast.errors import ModelWarning
from holdfast.view import meshes
from tests.robots.mesh_files.written import stl_bytes

EXAMPLES = Path(__file__).parents[2] / "examples"
BOX = hf.HeldObject.box(3.0, 0.3, 0.2, 0.2)
LEFT, RIGHT = ((x, 0, 0, *wxyz) for x, wxyz in ((-0.15, (0.5, -0.5, 0.5, -0.5)), (0.15, (0.5, -0.5, -0.5, 0.5))))
AT = {"left": hf.Pose.translation(-0.55, 0, 0), "right": hf.Pose.from_wxyz_xyz([0, 0, 0, 1, 0.55, 0, 0])}


def frame(x, y, z, *wxyz):
    return hf.Pose.from_wxyz_xyz([*wxyz, x, y, z])


GRASPS = {"left": hf.Grasp("rigid", frame(*LEFT)), "right": hf.Grasp("rigid", frame(*RIGHT))}


def pandas(held=BOX, grasps=GRASPS, gravity=(0, 0, -9.81), at=AT):
    """Return two Pandas that hold an object."""
    return hf.ClosedChain({name: hf.robots.panda(pose) for name, pose in at.items()}, held, grasps, gravity)


def with_left(pose):
    return {**GRASPS, "left": hf.Grasp("rigid", pose)}


UPSIDE_DOWN = hf.Pose.from_rpy(np.pi, 0, 0)
UNLIKELY = {
    "gravity upward": (pandas(gravity=(0, 0, 9.81)), "gravity: .* points upward, .* try -z"),
    "3,000 kg in a small box": (pandas(hf.HeldObject.box(3000.0, 0.3, 0.2, 0.2)), r"3000 kg in a box of .*: g instead"),
    "3,000 kg": (
        pandas(hf.HeldObject.box(3000.0, 1.3, 1.2, 1.2)),
        r"3000 kg are 9\d times the mass of its arms: g ins",
    ),
    "a box in millimetres": (
        pandas(hf.HeldObject.box(3.0, 300.0, 200.0, 200.0)),
        "a box of 300 x 200 x 200 m.*mm inst",
    ),
    "z out": (
        pandas(grasps=with_left(frame(*LEFT) @ UPSIDE_DOWN)),
        r"grasp 'left': the contact frame's z axis points out .* frame @ Pose.from_rpy\(pi, 0, 0\)",
    ),
    "a grasp's quaternion": (
        pandas(grasps=with_left(frame(0, -0.1, 0, -(0.5**0.5), 0, 0, 0.5**0.5))),  # a turn about x, from z to y
        r"grasp 'left': was the quaternion \[-0.7071, 0, 0, 0.7071\] meant as x, y, z, w\? As w, x, y, z it is"
        r" \[0.7071, -0.7071, 0, 0\]; then z would point into the object",
    ),
    "a base's quaternion": (
        pandas(at={**AT, "left": frame(-0.55, 0, 0, 0, 0, np.sin(0.4), np.cos(0.4))}),
        r"arm 'left': base: was the quaternion \[0, 0, 0.3894, 0.9211\] meant as x, y, z, w\? As w, x, y, z it is"
        r" \[0.9211, 0, 0, 0.3894\]; then z would point upward",
    ),
}


@pytest.mark.parametrize("name", UNLIKELY)
def test_unlikely(name):
    """One note each, which names the part and the cause."""
    chain, expected = UNLIKELY[name]
    (note,) = plausibility_notes(chain)
    assert re.search(expected, note)


def test_advice_works():
    """The frame that a note advises, and the quaternion that it states, lead to no note."""
    turned = frame(*LEFT) @ UPSIDE_DOWN @ hf.Pose.from_rpy(np.pi, 0, 0)
    assert not plausibility_notes(pandas(grasps=with_left(turned)))
    assert not plausibility_notes(pandas(grasps=with_left(frame(0, -0.1, 0, -(0.5**0.5), 0.5**0.5, 0, 0))))
    assert not plausibility_notes(pandas(at={**AT, "left": frame(-0.55, 0, 0, np.cos(0.4), 0, 0, np.sin(0.4))}))


def test_likely():
    """Usual things: y up, no gravity, bases on walls and ceilings, contacts inside, edges, a heavy part in space."""
    chain = pandas()
    assert not plausibility_notes(chain, [hf.Pose.from_rpy(0.1, 0.2, 0.3)])
    for gravity in ((0, -9.81, 0), (0, 0, 0), (0, 9.81, 0)):
        assert not plausibility_notes(replace(chain, gravity=gravity))
    assert not plausibility_notes(pandas(hf.HeldObject.box(3000.0, 1.3, 1.2, 1.2), gravity=(0, 0, 0)))
    quarter = np.pi / 2
    for roll, pitch in ((quarter, 0), (-quarter, 0), (0, quarter), (2 * quarter, 0), (0, -quarter)):
        for yaw in (0.0, 0.3, quarter, 2 * quarter):
            wall = hf.Pose.from_rpy(0, 0, yaw, [-0.55, 0, 0]) @ hf.Pose.from_rpy(roll, pitch, 0)
            told = plausibility_notes(pandas(at={**AT, "left": wall}))
            # two of them are what a quarter turn about z looks like in the other order
            assert bool(told) == ((abs(roll), pitch, yaw) == (quarter, 0, 2 * quarter))
    for place in ([0, 0, 0], [-0.1, 0, 0], [-0.15, 0.1, 0]):
        assert not plausibility_notes(pandas(grasps=with_left(frame(*place, 0, 1, 0, 0))))
    crank = hf.Arm([hf.Joint("revolute", [0, 1, 0])], [hf.Link(1.0, [0.1, 0, 0], 0.01 * np.eye(3))])
    pinned = {"crank": hf.Grasp("hinge", GRASPS["left"].frame @ UPSIDE_DOWN)}
    assert not plausibility_notes(hf.ClosedChain({"crank": crank}, BOX, pinned))
    assert plausibility_notes(hf.ClosedChain({"crank": crank}, BOX, {
        "crank": hf.Grasp("ball", pinned["crank"].frame, hf.Friction(0.5))}))  # fmt: skip
    (note,) = plausibility_notes(chain, [frame(0, 0, 0.7, 0, 0, 0, 1)])
    assert "half a turn about z; if none was meant: [1, 0, 0, 0]" in note


@pytest.mark.parametrize("scene", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_are_likely(scene):
    """The example scenes have no notes of this kind."""
    found = hf.load_scene(scene)
    assert not plausibility_notes(found.chain, found.state.object_frames)


def test_normals():
    """Of a box that is turned and shifted, a sphere and a cylinder; none beside the surface or on an edge."""
    turn = hf.Pose.from_rpy(0.3, -0.5, 0.8, [0.1, 0.2, 0.3])
    box = hf.HeldObject.box(2.0, 0.3, 0.2, 0.4)
    moved = hf.HeldObject(2.0, turn.R @ box.inertia @ turn.R.T, turn.p)
    for place, normal in (([0.15, 0.05, -0.1], [1, 0, 0]), ([0.1, -0.1, 0], [0, -1, 0]), ([0, 0, 0.2], [0, 0, 1])):
        assert outward_normal(moved, turn.R @ place + turn.p) == pytest.approx(turn.R @ normal, abs=1e-6)
    for place in ([0.15, 0.1, 0], [0.1, 0, 0], [0.2, 0, 0], [0.15, 0.3, 0]):
        assert outward_normal(moved, turn.R @ place + turn.p) is None
    ball, can = hf.HeldObject.sphere(1.0, 0.1), hf.HeldObject.cylinder(1.0, 0.1, 0.3)
    assert outward_normal(ball, np.array([0, 0.06, 0.08])) == pytest.approx([0, 0.6, 0.8])
    assert outward_normal(can, np.array([0.06, -0.08, 0.1])) == pytest.approx([0.6, -0.8, 0])
    assert outward_normal(can, np.array([0.03, 0.02, -0.15])) == pytest.approx([0, 0, -1])
    for held, place in ((ball, [0, 0, 0.11]), (can, [0, 0, 0]), (can, [0.1, 0, 0.15]), (can, [0.2, 0, 0.1])):
        assert outward_normal(held, np.array(place, dtype=float)) is None


def test_a_part_in_millimetres(tmp_path):
    """A file in millimetres is noted where it is read, and in reports, by mass and by density; scaled, it is not."""
    path = tmp_path / "part.stl"
    path.write_bytes(stl_bytes(1000.0 * meshes.box((0.2, 0.1, 0.1)).vertices[meshes.box((0.2, 0.1, 0.1)).faces]))
    for given in ({"mass": 2.0}, {"density": 1000.0}):
        with pytest.warns(
            ModelWarning, match=r"part.stl: as large as a box of 200 x 100 x 100 m, .* Try scale=0.001"
        ) as said:
            held = hf.HeldObject.from_mesh(path, **given)
        assert said[0].filename == __file__
        notes = plausibility_notes(pandas(held))
        assert "millimetres" in notes[0] and "scale=0.001" in notes[0]
    assert not plausibility_notes(pandas(hf.HeldObject.from_mesh(path, mass=2.0, scale=0.001)))


def test_where_notes_are_seen(tmp_path, capfd):
    """In the report of `assemble`, in `Scenario.notes`, and with the commands that read a scene."""
    found = hf.assemble({"left": hf.robots.panda()}, replace(BOX, mass=3000.0, inertia=1000 * BOX.inertia),
                        {"left": GRASPS["left"]})  # fmt: skip
    (note,) = found.report.unlikely
    assert f"  note: {note}\n" in str(found.report)
    scene = tmp_path / "heavy.toml"
    text = (EXAMPLES / "two_pandas.toml").read_text()
    scene.write_text(f"gravity = [0, 0, 9.81]\n{text}")
    assert "points upward" in hf.load_scene(scene).notes[0]
    assert main(["diagnose", str(scene)]) == 0
    assert "note: gravity: [0, 0, 9.81] points upward" in capfd.readouterr().err
