"""Calibration from closed postures: errors as the covariance says, derivatives, what is not determined, results."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import holdfast as hf
from holdfast.calibration import ClosureNoise, FrameMeasurement, Postures, next_postures
from holdfast.calibration.geometry import gaps
from holdfast.calibration.problem import FitPoint
from holdfast.dynamics import link_poses, tip_pose
from holdfast.errors import HoldfastError, ModelError, StateError
from tests.calibration.cells import JOINTS, SHIFT, TURN, cell, distance, moved, share_found, sought
from tests.calibration.planted import CASES
from tests.longer import mostly_slow
from tests.systems.branched import two_arms_with_grippers

NOISE = ClosureNoise(TURN, SHIFT, JOINTS)


def test_derivatives_are_those_of_central_differences() -> None:
    one = cell(3, count=3)
    seek = ["bases:left", "bases:right", "grasps", "tips", "offsets", "geometry:left", "markers", "sensors"]
    seen = FrameMeasurement("left/link2", np.tile([1.0, 0, 0, 0, 0.3, 0.2, 0.1], (3, 1)))
    arms = {
        name: arm.of(links=[replace(link, name=f"link{k + 1}") for k, link in enumerate(arm.links)])
        for name, arm in one.model.arms.items()
    }
    model = replace(one.model, arms=arms)
    found = hf.calibrate(model, Postures(one.q, measured={"seen": seen}), seek, noise=NOISE)
    problem, random = found.problem, np.random.default_rng(0)
    x = 0.3 * random.normal(size=len(found.names))
    at = problem.start(x)
    at = at.moved(problem, 0.0 * x, 0.1 * random.normal(size=(3, 6)))
    here = gaps(problem.layout, at.x, at.q, at.free)

    def shifted(dx: Any, dq: Any, dy: Any) -> Any:
        to = FitPoint(at.x, at.q + dq, at.free).moved(problem, dx, dy)
        return gaps(problem.layout, to.x, to.q, to.free).gaps

    still, zero = np.zeros(len(x)), np.zeros((3, 6))
    step = 1e-6
    for k, e in enumerate(np.eye(len(x))):
        slope = (shifted(step * e, 0.0, zero) - shifted(-step * e, 0.0, zero)) / (2 * step)
        assert np.allclose(here.unknowns[:, :, k], slope, atol=1e-8)
    for k, e in enumerate(np.eye(one.q.shape[1])):
        slope = (shifted(still, step * e, zero) - shifted(still, -step * e, zero)) / (2 * step)
        assert np.allclose(here.joints[:, :, k], slope, atol=1e-8)
    for k, e in enumerate(np.eye(6)):
        turned = np.tile(e, (3, 1))
        slope = (shifted(still, 0.0, step * turned) - shifted(still, 0.0, -step * turned)) / (2 * step)
        assert np.allclose(here.free[:, :, k], slope, atol=1e-8)


def test_regions_hold_the_truth_as_often_as_they_say() -> None:
    squared, dimensions, given = 0.0, 0, []
    for seed in range(6):
        one = cell(seed)
        found = hf.calibrate(one.model, one.q, sought(one), noise=NOISE)
        error, count = distance(one, found)
        assert count == len(found.names)
        assert not found.undetermined
        squared, dimensions = squared + error, dimensions + count
        given.append(found.misfit)
    assert chi2.ppf(1e-4, dimensions) < squared < chi2.ppf(1 - 1e-4, dimensions)
    assert np.isclose(np.mean(given), 1.0, atol=0.15)


@pytest.mark.long
def test_nine_of_ten_regions_hold_the_truth() -> None:
    inside = []
    for seed in range(100):
        one = cell(1000 + seed)
        found = hf.calibrate(one.model, one.q, sought(one), noise=NOISE)
        error, count = distance(one, found)
        inside.append(error < chi2.ppf(0.9, count))
    assert 0.8 < np.mean(inside) < 0.98


@pytest.mark.parametrize("name", mostly_slow(CASES, ["planar motion", "two postures", "a ball"]))
def test_what_postures_cannot_determine_is_found_and_the_rest_is_right(name: str) -> None:
    one, seek, planted = CASES[name](0)
    found = hf.calibrate(one.model, one.q, seek, noise=NOISE)
    assert share_found(found, planted) > 0.99
    assert found.fitted.null.shape[1] == len(found.undetermined) == len(planted)
    error, count = distance(one, found)
    assert error < chi2.ppf(1 - 1e-5, max(count, 1))
    for direction in planted:
        assert not np.isfinite([found.deviations[k] for k, value in direction.items() if abs(value) > 0.2]).any()


def test_height_of_a_base_is_named_in_words() -> None:
    one, seek, _ = CASES["planar motion"](1)
    (said,) = hf.calibrate(one.model, one.q, seek, noise=NOISE).undetermined
    assert said.startswith("the position of the base of 'right' along z is not determined by these postures")


def test_calibrated_chain_is_closed_where_the_truth_is() -> None:
    one = cell(5)
    found = hf.calibrate(one.model, one.q, sought(one), noise=NOISE)
    left, right = found.chain.arms.values()
    n = left.joint_count
    for q in one.q:
        box = tip_pose(left, q[:n]) @ found.chain.grasps["left"].frame.inverse()
        gap = (box @ found.chain.grasps["right"].frame).inverse() @ tip_pose(right, q[n:])
        assert np.abs(gap.p).max() < 1e-3
        assert np.linalg.norm(Rotation.from_matrix(gap.R).as_rotvec()) < 3e-3
    assert np.allclose(found.chain.arms["right"].base.p, one.truth.arms["right"].base.p, atol=1e-3)


def test_estimated_noise_is_that_of_the_closures() -> None:
    one = cell(2, count=60)
    found = hf.calibrate(one.model, one.q, sought(one))
    assert 0.5 * TURN < found.noise["closures turn"] < 4 * TURN
    assert 0.5 * SHIFT < found.noise["closures shift"] < 4 * SHIFT
    assert np.isclose(found.misfit, 1.0, atol=0.05)


def test_degrees_are_named() -> None:
    one = cell(5)
    right = hf.calibrate(one.model, one.q, ["bases:right"], noise=NOISE)
    assert not any("degrees" in note for note in right.notes)
    wrong = hf.calibrate(one.model, np.degrees(one.q), ["bases:right"], noise=NOISE)
    assert "q of 'left/joint1' goes up to" in wrong.notes[0]
    assert "most likely they are degrees" in wrong.notes[0]


def test_postures_that_slipped_count_less() -> None:
    one = cell(4, count=40)
    spoiled = np.array(one.q)
    spoiled[[3, 17]] += 0.05
    plain, robust = (hf.calibrate(one.model, spoiled, sought(one), noise=NOISE, robust=flag) for flag in (False, True))
    truth = np.array([one.x[name] for name in plain.names])
    assert np.linalg.norm(robust.values - truth) < 0.2 * np.linalg.norm(plain.values - truth)
    assert set(np.flatnonzero(robust.weights < 0.2)) == {3, 17}
    assert any("3, 17" in note for note in robust.notes)


def test_priors_hold_what_postures_do_not_determine() -> None:
    one = cell(6)
    found = hf.calibrate(one.model, one.q, ["bases", "grasps", "offsets:right"], prior={"offsets": 5e-3}, noise=NOISE)
    assert any("keeps the prior's value" in said for said in found.undetermined)
    wide = hf.calibrate(one.model, one.q, sought(one), prior={"bases": 0.1, "grasps": (0.1, 0.05)}, noise=NOISE)
    assert distance(one, wide)[0] < chi2.ppf(1 - 1e-5, len(wide.names))


def measured(chain: hf.ClosedChain, q: Any, marker: hf.Pose, sensor: hf.Pose) -> Any:
    """Return the poses (postures, 7) of a marker on the left tip that a sensor sees."""
    arm = chain.arms["left"]
    return np.array([(sensor.inverse() @ tip_pose(arm, row[: arm.joint_count]) @ marker).wxyz_xyz for row in q])


@pytest.mark.parametrize("posed", [True, False])
def test_markers_and_sensors_are_found_from_poses_or_positions(posed: bool) -> None:
    one, random = cell(7), np.random.default_rng(0)
    corrections = [random.normal(scale=np.repeat([0.05, 0.02], 3)) for _ in range(2)]
    marker, sensor = (
        moved(hf.Pose.translation(*p), x) for p, x in zip(([0, 0, 0.1], [1, 0, 0]), corrections, strict=True)
    )
    poses = measured(one.model, one.q, marker, sensor)
    guess = {"marker": hf.Pose.translation(0, 0, 0.1), "sensor": hf.Pose.translation(1, 0, 0)}
    seen = FrameMeasurement("left", poses if posed else poses[:, 4:], **guess)
    free = replace(one.model, grasps={})
    found = hf.calibrate(
        free, Postures(one.q, measured={"seen": seen}), ["markers", "sensors"], noise=ClosureNoise(1e-4, 1e-5)
    )
    assert np.allclose(found.sensors["seen"].p, sensor.p, atol=1e-8)
    assert np.allclose(found.sensors["seen"].R, sensor.R, atol=1e-8)
    assert np.allclose(found.markers["seen"].p, marker.p, atol=1e-8)
    assert np.allclose(found.markers["seen"].R, marker.R, atol=1e-8) == posed
    assert len(found.undetermined) == (0 if posed else 3)  # positions do not show how the marker is turned
    half = Postures(one.q, measured={"seen": seen}).part(slice(5))
    assert found.errors_of(half)["seen"][1] < 1e-8


def test_one_joint_that_was_not_measured_is_found_along_the_way() -> None:
    one = cell(8, offsets=False)
    q = np.array(one.q)
    known = q[:, 3].copy()
    q[:, 3] = np.where(np.arange(len(q)) % 3 == 0, np.nan, q[:, 3])
    found = hf.calibrate(one.model, q, noise=NOISE)
    assert distance(one, found)[0] < chi2.ppf(1 - 1e-5, len(found.names))
    assert np.isfinite(known).all()


def test_next_postures_beat_random_ones() -> None:
    one, more = cell(9, count=4), cell(9, count=60)
    begun = hf.calibrate(more.model, more.q[:4], sought(one), noise=NOISE)

    def volume(chosen: Any) -> float:
        both = np.vstack([more.q[:4], chosen])
        found = hf.calibrate(more.model, both, sought(one), noise=NOISE)
        return float(np.linalg.slogdet(found.covariance)[1])

    best = next_postures(begun, more.q[4:], 6)
    random = np.random.default_rng(1)
    assert volume(best.q) < min(volume(more.q[4:][random.permutation(56)[:6]]) for _ in range(3)) - 1.0


def test_candidates_are_closed_and_within_limits() -> None:
    from holdfast.robots import ur5e

    arms = {"left": ur5e(hf.Pose.translation(-0.5, 0, 0)), "right": ur5e(hf.Pose.from_rpy(0, 0, np.pi, [0.5, 0, 0]))}
    frames = {
        "left": hf.contact_frame([-0.15, 0, 0], into=[1, 0, 0]),
        "right": hf.contact_frame([0.15, 0, 0], into=[-1, 0, 0]),
    }
    grasps = {name: hf.Grasp("rigid", frame) for name, frame in frames.items()}
    chain, state = hf.assemble(
        arms, hf.HeldObject.box(1, 0.3, 0.2, 0.2), grasps, object_pose=hf.Pose.translation(0, 0, 0.4)
    )
    begun = hf.calibrate(chain, [state.q], noise=NOISE)
    chosen = next_postures(begun, state, 4, tries=12)
    assert len(chosen) == 4
    low, high = chain.position_limits.T
    assert ((chosen.q >= low) & (chosen.q <= high)).all()
    for errors in begun.errors_of(chosen).values():
        assert max(errors) < 1e-5
    assert len(hf.calibrate(chain, np.vstack([[state.q], chosen.q]), noise=NOISE).undetermined) == 0


def test_chains_with_branches_are_calibrated_by_their_pads() -> None:
    p = two_arms_with_grippers()
    n = p.chain.positions["arm2"].stop
    q = p.state.q[None, :n] + 1e-3 * np.random.default_rng(0).normal(size=(5, n))
    found = hf.calibrate(p.chain, q, ["bases:arm2", "offsets:arm1"], noise=ClosureNoise(1e-3, 1e-3, 1e-3))
    assert found.chain.beyond_serial
    assert found.undetermined


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seek": ["base"]}, "seek: got 'base'. Did you mean"),
        ({"seek": []}, "expected a list of bases"),
        ({"seek": "sensors"}, "nothing in 'sensors'"),
        ({"postures": np.zeros((3, 5))}, "expected 1[2-4] joint positions, got 5"),
        ({"postures": np.full((3, 4), np.inf)}, "infinite"),
        ({"prior": {"offsets": 1.0}}, "nothing is sought in 'offsets'"),
        ({"prior": {"bases": -1.0}}, "expected > 0"),
        ({"noise": 1e-3}, "noise: expected"),
        ({"largest_deviation": 0.0}, "largest_deviation: expected > 0"),
    ],
)
def test_mistakes_are_named(change: dict[str, Any], message: str) -> None:
    one = cell(0, count=3)
    with pytest.raises(HoldfastError, match=message):
        hf.calibrate(**{"chain": one.model, "postures": one.q, **change})


def test_one_grasp_alone_shows_nothing() -> None:
    one = cell(0, count=3)
    with pytest.raises(StateError, match="try a second grasp"):
        hf.calibrate(one.model.without_grasp("right"), one.q, ["bases:left"])
    screw = replace(one.model, grasps={**one.model.grasps, "right": hf.Grasp("screw", pitch=0.1)})
    with pytest.raises(HoldfastError, match="closed directions are axes, got a screw"):
        hf.calibrate(screw, one.q)
    with pytest.raises(StateError, match="explain all but"):
        hf.calibrate(one.model, one.q[:2], ["bases", "grasps", "offsets"])


def test_urdf_has_the_calibrated_origins(tmp_path: Any) -> None:
    inertia = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    links = "".join(f'<link name="l{k}"><inertial>{inertia}</inertial></link>' for k in range(8))
    random = np.random.default_rng(0)
    rows = [" ".join(f"{x:.6f}" for x in random.uniform(-0.3, 0.3, 3)) for _ in range(14)]
    joints = "".join(
        f'<joint name="j{k}" type="{"fixed" if k == 3 else "continuous"}"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{rows[2 * k]}" rpy="{rows[2 * k + 1]}"/><axis xyz="{"0 1 0" if k % 2 else "0 0 1"}"/></joint>'
        for k in range(7)
    )
    source, target = tmp_path / "arm.urdf", tmp_path / "calibrated.urdf"
    source.write_text(f'<robot name="arm">{links}{joints}</robot>')
    arm = hf.load_urdf(source)
    free = hf.ClosedChain({"left": arm}, hf.HeldObject.box(1, 1, 1, 1), {})
    q = random.uniform(-2, 2, (20, 6))
    offsets = random.normal(scale=0.01, size=6)
    poses = measured(free, q + offsets, hf.Pose.identity(), hf.Pose.identity())
    seen = FrameMeasurement("left", poses)
    found = hf.calibrate(free, Postures(q, measured={"seen": seen}), "offsets", noise=ClosureNoise(1e-5, 1e-5))
    assert np.allclose(found.values, offsets, atol=1e-9)
    changed = hf.calibration.write_urdf(found, source, target)
    assert changed == ["j0", "j1", "j2", "j4", "j5", "j6"]
    again = hf.load_urdf(target)
    for row in q[:3]:
        for a, b in zip(link_poses(again, row), link_poses(arm, row + offsets), strict=True):
            assert np.allclose(a.p, b.p, atol=1e-8)
        assert np.allclose(tip_pose(again, row).R, tip_pose(found.chain.arms["left"], row).R, atol=1e-9)
    xyz, rpy = found.urdf_origins()["left/j1"]
    assert np.allclose(Rotation.from_euler("xyz", rpy).as_matrix(), found.chain.arms["left"].joints[1].placement.R)
    assert np.allclose(xyz, found.chain.arms["left"].joints[1].placement.p)
    for nothing in (tmp_path / "none.urdf", None, b"bytes", "", "a\0b"):
        with pytest.raises(ModelError, match=r"expected a (URDF file|path)"):
            hf.calibration.write_urdf(found, nothing, target)
    for nowhere in (None, 3, "", tmp_path / "no" / "arm.urdf"):
        with pytest.raises(hf.errors.ResultError):
            hf.calibration.write_urdf(found, source, nowhere)


def test_postures_are_read_from_a_table(tmp_path: Any) -> None:
    one = cell(0, count=4)
    path = tmp_path / "postures.csv"
    head = [*(f"q {name} [rad]" for name in one.model.joint_names()), "holds right"]
    rows = [head, *([*map(repr, row), str(int(k > 0))] for k, row in enumerate(one.q.tolist()))]
    path.write_text("\n".join(",".join(row) for row in rows))
    read = hf.calibration.load_postures(path, one.model)
    assert np.array_equal(read.q, one.q)
    assert read.holds["right"].tolist() == [False, True, True, True]
    direct = hf.calibrate(one.model, path, noise=NOISE)
    assert np.array_equal(direct.values, hf.calibrate(one.model, read, noise=NOISE).values)
    path.write_text(path.read_text().replace("q left/joint2", "left/j2"))
    with pytest.raises(hf.errors.ResultError, match="expected a column 'q left/joint2'"):
        hf.calibration.load_postures(path, one.model)


def test_postures_are_read_from_the_folder_of_a_run(tmp_path: Any) -> None:
    """What says that it takes a result folder does, and a path where nothing is is called that."""
    arm = hf.Arm([hf.Joint("revolute", [0, 0, 1.0])], [hf.Link(1.0, [0.1, 0, 0], 0.01 * np.eye(3))])
    box, grasps = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1), {"arm": hf.Grasp("rigid", hf.Pose.identity())}
    chain, state = hf.assemble({"arm": arm}, box, grasps, q={"arm": [0.3]})
    run = hf.simulate(chain, state, lambda t, state, memory: (np.zeros(1), memory), 0.02, 0.01)
    run.save(tmp_path / "run")
    assert np.array_equal(hf.calibration.load_postures(tmp_path / "run", chain).q, run.q)
    for nothing in ("nothing", "nothing.csv"):
        with pytest.raises(hf.errors.ResultError, match=r"[Nn]o such file"):
            hf.calibration.load_postures(tmp_path / nothing, chain)
