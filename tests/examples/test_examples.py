"""Every numbered example, run as it stands: its figures obey the laws they are about, and its picture is there."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))


def script(path: Path) -> ModuleType:
    """Return an example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that runs an example's main and returns its figures and what it printed."""

    def run(number: str, **options: Any) -> tuple[dict[str, Any], str]:
        (path,) = EXAMPLES.glob(f"{number}_*.py")
        found = script(path).main(tmp_path, **options)
        picture = (tmp_path / f"{path.stem}.png").read_bytes()
        assert picture.startswith(b"\x89PNG") and len(picture) > 5000
        return found, capsys.readouterr().out

    return run


def test_the_ladder():
    """None longer than a hundred lines, each in the table of the folder's README."""
    assert [path.name[:2] for path in SCRIPTS] == [f"{k:02}" for k in (*range(1, 18), *range(19, 27))]
    table = (EXAMPLES / "README.md").read_text()
    for path in SCRIPTS:
        assert len(path.read_text().splitlines()) <= 100, path.name
        assert f"]({path.name})" in table


@pytest.mark.slow
def test_one_arm(run):
    """The hand carries the weight; without drives it gives m (a - g), and energy is kept."""
    found, printed = run("01")
    assert found["held"] == pytest.approx(found["weight"], rel=1e-12)
    assert found["acceleration_held"] < 1e-11
    assert found["newton_error"] < 1e-11
    assert found["after"] < 0.5 * found["weight"]
    assert found["energy_error"] < 1e-4 * found["energy_moved"]
    assert "19.62" in printed


@pytest.mark.slow
def test_two_arms_one_box(run):
    """Two arms of seven joints and six constraints each leave eight freedoms; the loop is closed to rounding."""
    found, printed = run("02")
    assert found["mobility"] == 7 + 7 + 6 - 12
    assert found["gap"] < 1e-14
    assert found["lifted"] == pytest.approx(0.25, abs=1e-4)
    assert found["miss"] < 1e-5
    assert found["energy_error"] < 1e-3
    assert "mobility 8" in printed


@pytest.mark.slow
def test_forces_at_each_hand(run):
    """They sum to m (a - g); what squeezes sums to nothing; at rest each hand has half the weight."""
    found, _ = run("03")
    assert found["newton_error"] < 1e-11
    assert found["internal_sum"] < 1e-11
    assert found["left_up"] == pytest.approx(found["weight"] / 2, rel=1e-10)
    assert found["right_up"] == pytest.approx(found["weight"] / 2, rel=1e-10)
    assert found["internal_force"] == pytest.approx(30.0, rel=1e-10)
    assert found["largest"] > np.hypot(30.0, found["weight"] / 2)


def test_who_carries_what(run):
    """Shares sum to 1 and follow the closed forms: the lever with balls, half of it with rigid hands."""
    found, _ = run("04")
    for kind, lever in (("ball", 2), ("rigid", 4)):
        assert found[kind].sum(axis=1) == pytest.approx(1.0, abs=1e-12)
        assert found[kind][:, 1] == pytest.approx(0.5 + found["offsets"] / (lever * 0.15), abs=1e-9)


@pytest.mark.slow
def test_soft_fingers_slipping(run):
    """All three give way where mu N = m g / 3, to a nanosecond though steps are 20 ms."""
    found, printed = run("05")
    assert found["margin"] == pytest.approx(found["margin_expected"], rel=1e-9)
    assert found["slip"] == pytest.approx(found["slip_expected"], abs=1e-9)
    assert found["slipped"] == 3
    assert "slips at t = 0.385243" in printed


@pytest.mark.slow
def test_hand_over(run):
    """The box's change of momentum is the hands' impulses; the whole chain's is that of wrenches and bases."""
    found, _ = run("06")
    assert found["change"] < -0.1
    assert found["impulse_error"] < 1e-9
    assert found["energy_change"] < 0
    assert found["momentum_error"] < 2e-4 * found["momentum_moved"]
    assert found["holds_at_end"] == "right"


@pytest.mark.slow
def test_stewart_platform(run):
    """Six drives hold six mobilities still, passive joints idle; work of the drives is the rise of the weights."""
    found, _ = run("07")
    assert found["mobility"] == 6
    assert found["residual"] < 1e-11
    assert found["load_error"] < 1e-11 * found["weight"]
    assert found["virtual_work"] == pytest.approx(found["potential"], rel=1e-6)
    assert found["spread_level"] < 1e-9
    assert found["mirrored"] < 1e-9


@pytest.mark.slow
def test_singular(run):
    """Near flat the pendulum's closed form, condition number as 1 / angle^2; flat, a refusal that names the rank."""
    found, printed = run("08")
    assert found["error"] < 1e-10
    assert found["status"] == "INDETERMINATE_FORCES"
    assert found["flat"] == "singular"
    assert "rank 8 of 12 here, but 9 nearby" in found["refusal"]
    assert found["refusal"] in printed
    assert found["growth"] == pytest.approx(2.0, abs=0.05)


def test_a_million_states(run):
    """Here a few thousand: every one is sound, obeys Newton, and is the reference's."""
    found, printed = run("09", batches=2)
    assert found["valid"] == found["states"] == 2 * 16_384
    assert found["newton_error"] < 1e-9
    assert found["reference_error"] < 1e-9
    assert "million a second" in printed


def test_your_own_robot(run):
    """The links weigh what the file says, hands carry the box, bases everything."""
    found, _ = run("10")
    assert found["mass"] == pytest.approx(3.0 + 4.0 + 2.5 + 1.0 + 0.8 + 0.3)
    assert found["left_up"] == pytest.approx(4.0 * 9.81 / 2, rel=1e-10)
    assert found["internal_force"] == pytest.approx(15.0, rel=1e-10)
    assert found["acceleration"] < 1e-10
    assert found["force_error"] < 1e-11
    assert found["base_load"] == pytest.approx((2 * found["mass"] + 4.0) * 9.81, rel=1e-10)
    assert 0 < found["use"] < 1


@pytest.mark.slow
def test_balance(run):
    """What falls without control, as fast as the linearisation says, is held with it."""
    found, _ = run("11")
    assert found["falling"] > 1.0 > 0.0 > found["held"]
    assert found["without"] > 100 * found["start"]
    assert found["regulated"] < 0.5 * found["start"]


@pytest.mark.slow
def test_identify(run):
    """Mass and mass centre from a motion without turns, which names the inertia as the guess's; all with turns."""
    found, printed = run("12")
    for one in found.values():
        assert abs(one.held_object.mass / 3.0 - 1) < 0.01
        assert np.linalg.norm(one.held_object.com - [0.03, -0.02, 0.05]) < 4e-3
    assert len(found["shifted"].kept) == 6 and not found["turned"].kept
    assert found["shifted"].notes == ()
    off = np.diag(found["turned"].held_object.inertia) - [0.06, 0.03, 0.05]
    sizes = [found["turned"].deviations[f"inertia {axes}"] for axes in ("xx", "yy", "zz")]
    assert (np.abs(off) < 4 * np.array(sizes)).all() and max(sizes) < 0.01
    assert "from the guess" in printed


@pytest.mark.slow
def test_learn_gains(run):
    """Gains that were learnt hold the box ten times as well, judged by what was asked for."""
    found, printed = run("13")
    assert min(found["costs"]) < 0.1 * found["costs"][0]
    assert found["off"]["learnt"].max() < 0.5 * found["off"]["first"].max()
    assert (found["gains"] > 0).all()
    assert "gradients of 16 runs" in printed


@pytest.mark.slow
def test_least_peak_torque(run):
    """Both ways end at rest at B, closed and within all limits; the best has a peak of at most three quarters."""
    found, printed = run("14")
    for one in found["runs"].values():
        assert one.stopped is None
        assert one.position_gap[:, 1].max() < 1e-14
        assert np.linalg.norm(one.object_pose[-1, 4:] - found["goal"]) < 1e-5
        assert np.abs(one.object_twist[-1]).max() < 1e-4
    assert found["used"]["optimised"].max() < 0.75 * found["used"]["straight"].max()
    cost, along = found["cost"], np.random.default_rng(0).normal(size=len(found["cost"].x0))
    ends = [cost(cost.x0 + k * 1e-4 * along)[0] for k in (1, -1, 2, -2)]
    slope = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / 12e-4
    assert cost(cost.x0)[1] @ along == pytest.approx(slope, rel=1e-6)
    assert printed.count("within all limits") == 2


@pytest.mark.slow
def test_learn_gains_in_jax(run):
    """Gains that were learnt hold boxes ten times as well, other pushes too; the gradient is that of differences."""
    jax = pytest.importorskip("jax", reason="needs JAX: pip install 'holdfast[jax]'")
    before = jax.config.jax_enable_x64
    try:
        found, printed = run("15")
        gains, seen = np.log(found["gains"]), found["seen"]
        along = np.random.default_rng(0).normal(size=gains.shape)
        ends = [float(found["learn"](gains + k * 1e-4 * along, seen)[0]) for k in (1, -1, 2, -2)]
        slope = float((found["learn"](gains, seen)[1] * along).sum())
    finally:
        jax.config.update("jax_enable_x64", before)
    assert found["costs"][-1] < 0.1 * found["costs"][0]
    assert found["unseen"]["learnt"] < 0.1 * found["unseen"]["first"]
    assert slope == pytest.approx((8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / 12e-4, rel=1e-5)
    assert "in 40 gradients of 8 runs each" in printed


@pytest.mark.slow
def test_lift_a_box(run):
    """Coulomb's law with the margin that was asked, at every moment, within the drives' share; a fifth of the force."""
    found, printed = run("16")
    assert found["coulomb_error"] < 1e-5
    assert found["least_margin"] == pytest.approx(2.0, abs=1e-6)
    assert (2.0 + 3.0 * 9.81 / 2) / 0.8 <= found["squeeze_at_rest"] < 21.0
    assert found["most_effort"] < 0.8
    assert found["lifted"] == pytest.approx(0.2, abs=1e-4)
    assert found["firmest_squeeze"] > 5 * found["squeeze_at_rest"]
    assert found["payload"] > 12.0
    assert "margin of the grasps: at least 2.0000 N" in printed


def test_gripper(run):
    """The grip is what virtual work says at every opening, through both four-bars; without weight nothing moves."""
    found, printed = run("17")
    assert found["deviation"] < 1e-10
    assert found["moved"] < 1e-10
    assert "9.091, 14.143 N" in printed


@pytest.mark.slow
def test_robotiq(run):
    """The motor's grip is what virtual work says, and moves nothing; its work and a push's are the energy gained."""
    found, printed = run("19")
    assert "rank 18 of 25, mobility 6" in printed
    assert found["deviation"] < 1e-11
    assert found["moved"] < 1e-11
    assert found["energy_error"] < 1e-5 < found["kinetic"]
    assert "3 in loop 'ur5e/left', 3 in loop 'ur5e/right'" in printed
    assert "1 among grasp 'ur5e/left_pad' and grasp 'ur5e/right_pad'" in printed


@pytest.mark.slow
def test_palletisers(run):
    """Torques as Roberval says, wherever the load is; two of them keep it level to rounding."""
    found, printed = run("20")
    assert found["offset"] < 1e-10
    assert found["still"] < 1e-11
    assert found["tilt"] < 1e-13
    assert found["rise"] > 0.01
    assert found["energy_error"] < 1e-6
    assert "rank 18 of 32, mobility 4" in printed


@pytest.mark.slow
def test_lid_on_a_pot(run):
    """The impulse on the pot is its change of momentum; in the end one hand carries pot and lid."""
    found, printed = run("21")
    assert found["lost"] < -1e-3
    assert found["energy_error"] < 1e-15
    assert found["momentum_error"] < 1e-12
    assert found["end"] == pytest.approx(3.5 * 9.81, rel=2e-3)
    assert found["imbalance"] < 1e-4
    assert "regular, rank 18, mobility 8" in printed


@pytest.mark.slow
def test_two_free_flyers(run):
    """Linear and angular momentum are printed alike before and after; the drives' work is the energy gained."""
    found, printed = run("22")
    assert found["momentum_error"] < 5e-6
    assert found["gained"] > 1.0
    assert found["work"] == pytest.approx(found["gained"], rel=1e-4)
    start, end = (line.partition(":")[2] for line in printed.splitlines() if line.startswith("momentum"))
    assert start == end


@pytest.mark.slow
def test_two_hands(run):
    """Six points and six soft fingertips are unique; three forces of a braked hand are not, and are named."""
    found, printed = run("23")
    assert [(one["rank"], one["rows"]) for one in found.values()] == [(18, 18), (24, 24), (24, 27)]
    for one in found.values():
        assert one["balance"] < 1e-11
        assert one["moved"] < 1e-9
        assert one["pressing"][3:] == pytest.approx(found["points"]["pressing"][3:], rel=1e-9)
    assert "here and nearby: among grasp 'left/tip1', grasp 'left/tip2', grasp 'left/tip3'" in printed


@pytest.mark.slow
def test_touch_the_world(run):
    """The box slides as far as Coulomb's law lets it; the wall bears 20 N; the peg is in the hole."""
    found, printed = run("24")
    v = (5.0 - 0.3 * 9.81) * 0.3
    assert found["distance"] == pytest.approx(0.5 * 0.3 * v + v**2 / (2 * 0.3 * 9.81), abs=1e-9)
    assert found["force"] == pytest.approx(20.0, abs=1e-2)
    assert found["depth"] > 0.01 and found["aside"] < 1e-3
    assert found["imbalance"] < 1e-2
    assert "0.1573 m" in printed


@pytest.mark.slow
def test_a_grip_that_slips(run):
    """Times and fall are those on paper; what gravity gives, friction takes; the hands hold again at the end."""
    found, printed = run("25")
    assert max(found["slip_error"], found["stick_error"]) < 1e-12
    assert max(found["fall_error"], found["imbalance"]) < 1e-13
    assert found["energy_error"] < 1e-12
    assert found["holds"] == 1.0
    assert printed.count("holds again") == 2


@pytest.mark.long
def test_place_on_a_table(run):
    """Nothing is within the table, the grasps stay closed, and in the end the table carries the box at rest."""
    found, printed = run("26")
    assert 0.25 < found["lands"] < found["flat"] < 0.7
    assert found["lowest_gap"] >= -1e-12 and found["closure"] <= 1e-12
    assert found["table"] == pytest.approx(found["weight"], rel=1e-9)
    assert found["left"] == found["right"] == 0.0
    assert found["uneven"] < 1e-12 and found["speed"] < 1e-9
    assert found["imbalance"] < 2e-3 * found["moved"]
    assert "29.430 N" in printed
