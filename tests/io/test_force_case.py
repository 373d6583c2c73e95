"""Questions about forces in case files: answered to the 50-digit results, and refused by the place of a fault."""

import copy
import json
import random
from pathlib import Path

import numpy as np
import pytest

from holdfast import forward_dynamics
from holdfast.cli import main
from holdfast.dynamics import Status
from holdfast.errors import SceneError
from holdfast.io import load_cases
from holdfast.io.case_file import Case
from holdfast.io.force_case import ForceCase, listed_name
from tests.io.mutations import at, places

FILE = Path(__file__).parents[1] / "data" / "cases_forces.json"
CASES = json.loads(FILE.read_text())["cases"]
BY_NAME = {case["name"]: case for case in CASES}
LOADED = {}


def loaded(name: str) -> ForceCase:
    """Return a stored case."""
    if not LOADED:
        LOADED.update({case.name: case for case in load_cases(FILE)})
    return LOADED[name]


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a case to a file and returns its path."""

    def write(case):
        file = tmp_path / "case.json"
        file.write_text(json.dumps(case), encoding="utf-8")
        return file

    return write


@pytest.fixture
def solve(capsys):
    """Return a function that solves a file by the command and returns exit code and answers."""

    def run(file, *options):
        code = main(["solve", str(file), "--format", "json", *options])
        out, err = capsys.readouterr()
        assert err == ""
        return code, json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))

    return run


@pytest.mark.slow
def test_every_question(solve):
    """The command's verdicts are right, values and least violations to 1e-8, torques to 1e-5 of their limits."""
    code, answers = solve(FILE, "--method", "all")
    assert code == 0
    assert [answer["name"] for answer in answers] == list(BY_NAME)
    for answer in answers:
        case = BY_NAME[answer["name"]]
        expected, force = case["expected"], case["question"]["force_scale"]
        assert answer["method"] == "embedding"
        assert answer["status"] == expected["status"], answer["name"]
        assert answer["error_vs_expected"] <= 2e-5
        if "value" in expected:
            assert answer["value"] == pytest.approx(expected["value"], rel=1e-8, abs=1e-8), answer["name"]
        for key in ("margin", "peak", "scale"):
            if key in expected:
                assert answer[key] == pytest.approx(expected[key], rel=1e-8)
        if "tau" in expected:
            chain = loaded(answer["name"]).chain
            sizes = np.array([joint.effort_limit for joint in chain.all_joints])
            missed = np.array(answer["tau"]) - expected["tau"]
            assert not missed[: len(missed) - len(sizes)].round(12).any()
            assert np.abs(missed[-len(sizes) :] / np.where(np.isfinite(sizes), sizes, 1.0)).max() <= 1e-5
        if expected.get("least_violation") is not None:
            assert answer["least_violation"] == pytest.approx(expected["least_violation"], abs=1e-8 * force)
        assert (answer["reason"] is not None) == (expected["status"] == "infeasible")


@pytest.mark.parametrize("name", [case["name"] for case in CASES if case["expected"]["status"] == "infeasible"])
def test_certificates(name, solve, write):
    """Multipliers in the cones, balanced over every motion, prove the expected least violation; no solver is asked."""
    question = loaded(name).question()
    _, (answer,) = solve(write(BY_NAME[name]))
    of, force = question.found, loaded(name).force
    slopes, total, weights = np.zeros(of.N.shape[1]), 0.0, 0.0
    assert set(answer["certificate"]) <= {listed_name(limit) for limit in question.limits}
    for limit in question.limits:
        z = np.array(answer["certificate"].get(listed_name(limit), np.zeros(len(limit.h))))
        assert z[0] >= np.linalg.norm(z[1:]) - 1e-12
        slopes += z @ limit.G @ of.N / (limit.weight * force)
        total += z @ (limit.h - limit.G @ of.v0) / (limit.weight * force)
        weights += z[0]
    assert np.abs(slopes).max() <= 1e-8
    assert total < 0.0
    assert weights == pytest.approx(1.0, abs=1e-8)
    assert total * force == pytest.approx(-BY_NAME[name]["expected"]["least_violation"], abs=1e-7 * force)
    assert answer["certificate_residual"] <= 1e-7


@pytest.mark.parametrize("name", [case["name"] for case in CASES if "tau" in case["expected"]], ids=lambda name: name)
def test_given_back(name):
    """Forward dynamics with the torques returns the acceleration, and the wrenches where they are unique."""
    case = loaded(name)
    question = case.question()
    of, v = question.found, question.asked("effort").v
    back = forward_dynamics(case.chain, case.state, of.T @ v + of.t, inputs=case.inputs)
    np.testing.assert_allclose(case.asked.rows @ back.object_acceleration, case.asked.values, atol=1e-10)
    np.testing.assert_allclose(back.qdd, v[of.qdd], atol=1e-10)
    if back.status is Status.OK:
        weight = 9.81 * case.chain.held_object.mass
        assert np.abs(back.grasp_wrench - of.grasp_wrenches(v)).max() <= 1e-10 * weight
    assert (back.status is Status.OK) == (name != "unfelt_loads")


@pytest.mark.parametrize("name", [case["name"] for case in CASES if case["question"]["form"] == "effort"])
def test_at_a_price(name):
    """Limits that can be kept are, at the expected cost; otherwise v is no less than the least violation."""
    case, expected = loaded(name), BY_NAME[name]["expected"]
    found = case.question().asked("elastic", 1e6)
    if expected["status"] == "optimal":
        assert found.extra <= 1e-7
        assert found.value == pytest.approx(expected["value"], rel=1e-6, abs=1e-6)
    else:
        least = expected["least_violation"] / case.force
        assert least * (1 - 1e-7) <= found.extra <= 1.01 * least


def test_a_sole(write, solve):
    """The faces of two rigid hands as soles: their half lengths reach the model, and each edge has a name."""
    case = copy.deepcopy(BY_NAME["two_rigid_effort"])
    del case["expected"]
    for arm in case["arms"]:
        del arm["grasp"]["wrench_limits"]
        arm["grasp"] |= {"type": "sole", "friction": {"mu": 0.5, "half_lengths": [0.05, 0.03]}}
    (found,) = load_cases(write(case))
    assert [grasp.contact.half_lengths for grasp in found.chain.grasps.values()] == 2 * [(0.05, 0.03)]
    names = [listed_name(limit) for limit in found.question().limits]
    assert len(set(names)) == len(names)
    assert sum(name.startswith(("front edge of", "side edge of")) for name in names) == 4
    assert solve(write(case))[0] == 0


@pytest.mark.parametrize(("length", "mass"), [(1.0, 1e-3), (1.0, 1e3), (0.1, 1e-3), (10.0, 30.0)])
@pytest.mark.parametrize("name", ["two_soft_tight", "three_soft_peak", "hinge_soft_overloaded"])
def test_scales(name, length, mass, write):
    """Long or heavy, the same chain: the value is the same, violations are forces.

    A cost compares accelerations of sliding joints with 10 m/s^2, so it is not asked at other lengths.
    """
    (small,) = load_cases(write(scaled(BY_NAME[name], 1.0, 1.0)))
    (large,) = load_cases(write(scaled(BY_NAME[name], length, mass)))
    one, other = (case.question().asked(case.form) for case in (small, large))
    assert other.verdict is one.verdict
    least = [case.question().asked("violation").extra for case in (small, large)]
    assert least[1] == pytest.approx(least[0], rel=1e-8)
    if one.verdict.value == "optimal" and (small.form == "peak" or length == 1.0):
        assert other.value == pytest.approx(one.value, rel=1e-8)


def scaled(case: dict, length: float, mass: float) -> dict:
    """Return a case in which lengths, and masses, are multiplied, with all that belongs to them; times are the same."""
    case = copy.deepcopy(case)
    del case["expected"]
    body = case["object"]
    force = length * mass

    def times(where: dict, factor: float, *keys: str) -> None:
        for key in keys:
            if where.get(key) is not None:
                where[key] = (factor * np.array(where[key])).tolist()

    times(case, length, "gravity")
    times(body, length, "com", "p", "v")
    times(body, mass, "mass")
    times(body, mass * length**2, "inertia")
    for arm in case["arms"]:
        times(arm, length, "tip")
        slides = np.array([joint["type"] == "prismatic" for joint in arm["joints"]])
        for key in ("q", "qd"):
            arm[key] = (np.where(slides, length, 1.0) * arm[key]).tolist()
        times(arm["base"], length, "p", "v", "v_dot")
        for joint, link in zip(arm["joints"], arm["links"], strict=True):
            times(joint, length, "p0")
            turns = joint["type"] == "revolute"
            times(joint, mass * (length**2 if turns else 1.0), "armature", "damping")
            times(joint, force * (length if turns else 1.0), "effort")
            times(link, length, "com")
            times(link, mass, "mass")
            times(link, mass * length**2, "inertia")
        grasp = arm["grasp"]
        times(grasp, length, "point_object")
        times(grasp, force, "least_normal", "most_normal")
        if "friction" in grasp:
            times(grasp["friction"], length, "torsion_radius", "half_length")
        if "wrench_limits" in grasp:
            times(grasp["wrench_limits"], force, "force")
            times(grasp["wrench_limits"], force * length, "moment")
    asked = case["question"]
    times(asked, force, "force_scale")
    asked["acceleration"] = (np.repeat([1.0, length], 3) * asked["acceleration"]).tolist()
    return case


FAULTS = [
    (("question", "form"), "best", "$.question.form: Invalid enum value 'best'"),
    (("question", "acceleration"), [0.0] * 5, "$.question.acceleration: expected shape (6,)"),
    (("question", "force_scale"), 0.0, "$.question.force_scale: expected > 0"),
    (("question", "hold"), [0.0] * 6, "$.question.hold: expected the acceleration at sigma = 0 for a scale"),
    (("question", "wish"), {"2": [0.0] * 6}, "$.question.wish.2: expected an index of an arm, 0 .. 1"),
    (
        ("question", "acceleration_limits"),
        [["x", 14, -1.0, 1.0]],
        "$.question.acceleration_limits[0]: expected an index",
    ),
    (("arms", 0, "tau"), [0.0] * 7, "$.arms[0]: Object contains unknown field `tau`"),
    (("arms", 0, "q"), [0.0] * 6, "$.arms[0].q: expected 7 entries"),
    (("arms", 1, "name"), "arm0", "$.arms[1].name: expected another name than 'arm0'"),
    (("arms", 0, "grasp", "type"), "screw", "$.arms[0].grasp.type: Invalid enum value 'screw'"),
    (
        ("arms", 0, "grasp", "frame_object"),
        np.zeros((3, 3)).tolist(),
        "$.arms[0].grasp.frame_object: expected a rotation",
    ),
    (("arms", 0, "grasp", "friction"), {"mu": 0.5}, "$.arms[0].grasp: a softfinger contact needs torsion_radius"),
    (("arms", 0, "grasp", "W"), [0.0], "$.arms[0].grasp.W: expected 2 relative rates"),
    (("arms", 0, "joints", 0, "effort"), -1.0, "$.arms[0].joints[0].effort_limit: expected > 0"),
    (("expected", "tau"), [0.0] * 3, "$.expected.tau: expected 14 entries"),
    (("expected", "status"), "good", "$.expected.status: Invalid enum value 'good'"),
]


@pytest.mark.parametrize(("where", "value", "message"), FAULTS, ids=lambda x: str(x)[:30])
def test_faults(where, value, message, write):
    """Each is refused by its place, on one line."""
    case = copy.deepcopy(BY_NAME["two_soft_effort"])
    at(case, where[:-1])[where[-1]] = value
    with pytest.raises(SceneError) as caught:
        load_cases(write(case))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(40))
def test_random_damage(seed, write):
    """Three random pieces of junk anywhere: the file loads, or one line says where it does not."""
    rng, case = random.Random(seed), copy.deepcopy(BY_NAME["two_soft_wish"])
    for _ in range(3):
        where = rng.choice(list(places(case)))
        junk = rng.choice([None, True, -1, 0, 1e308, "", "rigid", [], {}, [0.0] * 3, [[1.0, 0.0, 0.0]] * 3])
        at(case, where[:-1])[where[-1]] = junk
    if not isinstance(case, dict):
        return
    text = ": $"
    try:
        load_cases(write(case))
    except SceneError as refused:
        text = str(refused)
    assert ": $" in text
    assert "\n" not in text


def test_refusals_of_the_command(solve, write):
    """Open grasps, impossible accelerations and methods of forward dynamics have reasons instead of answers."""
    case = copy.deepcopy(BY_NAME["two_ball_effort"])
    del case["question"]["task"]
    case["question"]["acceleration"] = [5.0, -3.0, 2.0, 0.0, 0.0, 0.0]
    code, (answer,) = solve(write(case))
    assert (code, answer["status"], answer["tau"]) == (3, "refused", None)
    assert answer["reason"].startswith("impossible: acceleration: expected one that the arms can give")
    case = copy.deepcopy(BY_NAME["two_soft_effort"])
    case["arms"][0]["q"][0] += 0.1
    assert solve(write(case))[1][0]["reason"].startswith("inconsistent: ")
    code, (answer,) = solve(FILE, "--case", "one_contact", "--method", "kkt")
    assert (code, answer["status"]) == (3, "refused")
    assert answer["reason"].startswith("not_applicable: ")


def test_tables(capsys, write):
    """A table of many, the torques of one, the conflict of another; diagnose reads these files, too."""
    file = str(write([BY_NAME["one_contact"], BY_NAME["two_rigid_tight"]]))
    for arguments, words in (
        (("solve", file), ("one_contact", "two_rigid_tight", "infeasible")),
        (("solve", file, "--case", "one_contact"), ("effort: value 0.26037", "arm0/joint7")),
        (("solve", file, "--case", "two_rigid_tight"), ("together they lack 34.8 N",)),
        (("diagnose", file, "--case", "one_contact"), ("one_contact",)),
    ):
        assert main(list(arguments)) == 0
        out = capsys.readouterr().out
        assert all(word in out for word in words)


def test_mixed_files(write):
    """A file may hold problems of both kinds."""
    first = json.loads(FILE.with_name("cases.json").read_text())["cases"][0]
    kinds = [type(case) for case in load_cases(write([first, BY_NAME["one_contact"]]))]
    assert kinds == [Case, ForceCase]
