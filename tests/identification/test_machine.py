"""Identification of the whole machine, against values and torques that other code made."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import holdfast as hf
from holdfast.dynamics import inertial_parameters
from holdfast.errors import ModelError, StateError
from holdfast.identification import Prior, Recording, instants, measurement_errors
from holdfast.identification.feasible_bodies import is_feasible
from holdfast.identification.machine.coloured_noise import autoregressions
from holdfast.identification.machine.identify_machine import moving, without_object
from holdfast.identification.machine.log_cholesky import body_at, coordinates_of, no_thinner, reference_factor
from holdfast.identification.machine.unknowns import machine_unknowns
from holdfast.identification.rows import forces_without_friction
from holdfast.robots import HOME, panda
from holdfast.simulation.joint_friction import friction_torque
from tests.identification.recorded import BOX, recorded, two_pandas

COULOMB, DAMPING, OFFSET = np.linspace(0.3, 0.9, 7), np.linspace(1.5, 0.4, 7), np.linspace(-0.5, 0.5, 7)
ARMATURE = np.linspace(0.6, 0.2, 7)


def swung(samples: int = 60, size: float = 0.5) -> Recording:
    """Return a motion of one arm, with the torques of a Panda that holds nothing, found by inverse dynamics."""
    t = np.linspace(0.0, 4.0, samples)
    f = 2.0 * np.pi * np.array([0.4, 0.3, 0.5, 0.35, 0.6, 0.45, 0.55])
    x = f * t[:, None] + np.arange(7.0)
    q, qd, qdd = HOME["panda"] + size * np.sin(x), size * f * np.cos(x), -size * f**2 * np.sin(x)
    chain = hf.ClosedChain({"arm": panda()}, hf.HeldObject.box(1.0, 0.1, 0.1, 0.1))
    none = hf.Pose.identity()
    tau = [
        hf.inverse_dynamics(chain, hf.State(*now[:2], none), now[2], np.zeros((1, 6)))
        for now in zip(q, qd, qdd, strict=True)
    ]
    return Recording(t=t, q=q, qd=qd, qdd=qdd, tau=np.array(tau))


@cache
def rubbing() -> Recording:
    """Return that motion with the torques of drives and friction."""
    given = swung()
    assert given.qd is not None and given.qdd is not None and given.tau is not None
    dry = np.array([friction_torque(COULOMB, v) for v in given.qd])
    return replace(given, tau=given.tau + ARMATURE * given.qdd + DAMPING * given.qd + dry + OFFSET)


BARE = hf.ClosedChain({"arm": panda()})
OF_JOINTS = ("armature", "damping", "friction", "friction_offset")


def test_log_cholesky_coordinates_reach_every_body_and_only_possible_ones():
    """The coordinates of a body give it back; random ones are possible; derivatives are those of differences."""
    root = reference_factor(inertial_parameters(hf.HeldObject.box(1.0, 0.3, 0.2, 0.1)))
    assert root is not None
    theta = coordinates_of(root, inertial_parameters(BOX))
    assert np.allclose(body_at(root, theta)[0], inertial_parameters(BOX), rtol=1e-12, atol=1e-14)
    random = np.random.default_rng(0)
    assert all(is_feasible(body_at(root, random.normal(size=10))[0]) for _ in range(50))
    h = 1e-6
    slopes = [(body_at(root, theta + h * e)[0] - body_at(root, theta - h * e)[0]) / (2 * h) for e in np.eye(10)]
    assert np.allclose(body_at(root, theta)[1], np.array(slopes).T, atol=1e-8)


def test_a_filter_of_an_autoregression_has_the_covariance_of_its_noise():
    """C C^T is the Toeplitz matrix of the autocovariance a^k of a first-order process."""
    random, a = np.random.default_rng(1), 0.8
    noise = np.zeros(20000)
    for k, push in enumerate(random.normal(size=20000)):
        noise[k] = a * noise[k - 1] + push
    errors, parts = noise[:, None] / noise.std(), [slice(0, 9000), slice(9000, 20000)]
    (process,), size = autoregressions(errors, np.zeros((20000, 1, 1)), np.array([20000.0]), np.ones(1), parts)
    assert size == pytest.approx(1.0, rel=0.01)
    assert process.slow_noise == pytest.approx((1 + a) / (1 - a), rel=0.1)
    B = random.normal(size=(400, 3))
    wanted = B.T @ toeplitz(a ** np.arange(400.0)) @ B
    found = process.filtered(B)
    assert np.allclose(found.T @ found, wanted, atol=0.15 * np.abs(np.diag(wanted)).max())


def test_slow_noise_is_found_although_slow_unknowns_explain_much_of_it():
    """A trend of twelve slow sines is fitted to slow noise; what is left of it shows less than there is."""
    random, a, samples, found, plain = np.random.default_rng(2), 0.9, 600, [], []
    t = np.arange(samples) / samples
    trend = np.array([f(2 * np.pi * k * t) for k in range(1, 7) for f in (np.sin, np.cos)]).T
    for _ in range(30):
        noise = lfilter([np.sqrt(1 - a * a)], [1, -a], random.normal(size=samples + 200))[200:]
        left = noise - trend @ np.linalg.lstsq(trend, noise, rcond=None)[0]
        for slopes, to in ((trend[:, None, :], found), (0.0 * trend[:, None, :1], plain)):
            known = 1e-9 * np.ones(slopes.shape[2]) if slopes.any() else np.ones(1)
            (one,), size = autoregressions(left[:, None], slopes, np.array([600.0]), known, [slice(0, samples)])
            to.append(size * one.slow_noise)
    right = (1 + a) / (1 - a)
    assert np.mean(found) == pytest.approx(right, rel=0.1)
    assert np.mean(plain) < 0.75 * right  # the same residuals without this


def test_channels_have_one_process_unless_they_differ():
    """Two channels of the same colour share coefficients; a white and a slow one do not."""
    random = np.random.default_rng(3)
    white = random.normal(size=(2000, 2))
    slow = lfilter([np.sqrt(1 - 0.64)], [1, -0.8], white, axis=0)
    for both, same in ((slow, True), (np.column_stack([white[:, 0], slow[:, 1]]), False)):
        first, second = autoregressions(both, np.zeros((2000, 2, 1)), np.full(2, 2e3), np.ones(1), [slice(0, 2000)])[0]
        assert (first is second) == same


def test_a_thin_estimate_is_not_known_to_be_thin():
    """Away from the bound of possible bodies, slopes are those of a body as extended as the model."""
    theta = np.array([-5.0, 0.3, 0.1, 0.2, *np.zeros(6)])
    pseudo = np.linalg.eigvalsh(factor(no_thinner(theta, 1.0)))
    assert pseudo.min() == pytest.approx(1.0)
    thick = np.array([0.3, 0.2, 0.1, 0.4, *np.zeros(6)])
    assert np.allclose(no_thinner(thick, 1.0), thick)


def factor(theta: np.ndarray) -> np.ndarray:
    """Return T T^T of log-Cholesky coordinates."""
    T = np.diag(np.exp(theta[:4]))
    for value, place in zip(theta[4:], [(1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2)], strict=True):
        T[place] = value
    return T @ T.T


@pytest.mark.long
def test_a_joint_region_holds_its_estimate_and_not_what_is_far_off():
    """Regions of one and of all values; names that are unknown or not determined are refused."""
    exact = rubbing()
    assert exact.tau is not None
    noise = 0.2 * np.random.default_rng(4).normal(size=exact.tau.shape)
    found = hf.identify(BARE, replace(exact, tau=exact.tau + noise), by="tau", unknowns=OF_JOINTS)
    own = dict(zip(found.names, found.values.tolist(), strict=True))
    name = found.names[0]
    assert found.holds(own) and found.freedoms > 10.0
    assert not found.holds(own | {name: own[name] + 10.0 * found.deviations[name]})
    assert found.holds({name: own[name] + 1.6 * found.deviations[name]})
    assert not found.holds({name: own[name] + 1.8 * found.deviations[name]})
    with pytest.raises(ModelError, match="there is no 'x'"):
        found.holds({"x": 0.0})
    with pytest.raises(ModelError, match="probability below 1"):
        found.holds(own, level=1.0)


@pytest.mark.slow
def test_drives_and_friction_of_an_arm_that_holds_nothing():
    """Exact torques give the values of the joints, and a chain that has them."""
    found = hf.identify(BARE, rubbing(), by="tau", unknowns=OF_JOINTS)
    joints = found.chain.arms["arm"].joints
    assert np.allclose([j.armature for j in joints], ARMATURE, atol=1e-4)
    assert np.allclose([j.damping for j in joints], DAMPING, atol=1e-3)
    assert np.allclose([j.friction for j in joints], COULOMB, atol=1e-3)
    assert np.allclose(found.others["friction_offset"], OFFSET, atol=1e-3)
    assert found.chain.held_object is None and not found.kept and not found.partly
    left = measurement_errors(found.chain, swung(40, 0.3), "tau", found.others)
    given = swung(40, 0.3)
    assert given.qd is not None and given.qdd is not None
    dry = np.array([friction_torque(COULOMB, v) for v in given.qd])
    assert np.allclose(left, -(ARMATURE * given.qdd + DAMPING * given.qd + dry + OFFSET), atol=5e-3)


@pytest.mark.slow
def test_payload_and_joints_of_two_arms():
    """Noisy torques give values within their deviations, from a guess that is far off."""
    chain, state = two_pandas()
    given = recorded(chain, state, duration=6.0, rate=10.0)
    assert given.qd is not None and given.qdd is not None and given.tau is not None
    dry = np.array([friction_torque(np.tile(COULOMB, 2), v) for v in given.qd])
    tau = given.tau + np.tile(ARMATURE, 2) * given.qdd + dry
    random = np.random.default_rng(2)
    given = replace(given, tau=tau + 0.02 * tau.std(axis=0) * random.normal(size=tau.shape))
    guess = replace(chain, held_object=hf.HeldObject.box(1.5, 0.2, 0.2, 0.2))
    found = hf.identify(guess, given, by="tau", unknowns=["payload", "armature", "friction"])
    right = np.r_[BOX.mass, BOX.com, BOX.inertia[np.triu_indices(3)], np.tile(ARMATURE, 2), np.tile(COULOMB, 2)]
    sure = [k for k, name in enumerate(found.names) if np.isfinite(found.deviations[name])]
    off = [(found.values[k] - right[k]) / found.deviations[found.names[k]] for k in sure]
    assert len(sure) > 25 and np.abs(off).max() < 4.5
    assert found.held_object.mass == pytest.approx(BOX.mass, rel=0.1)


def test_gains_of_drives_need_a_known_weight():
    """Currents tell torques up to a factor; a known weight in the second recording tells the factor."""
    box, weight = hf.HeldObject.box(2.0, 0.2, 0.2, 0.2), hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    arm = hf.ClosedChain({"arm": panda()}, box, {"arm": hf.Grasp("rigid", hf.Pose.translation(0, 0, 0.1))})
    both = replace(arm, held_object=hf.HeldObject(3.0, box.inertia + weight.inertia))
    given, gains = replace(swung(30), tau=np.zeros((30, 7))), np.linspace(5.0, 9.0, 7)
    first, second = (
        replace(given, tau=None, current=-measurement_errors(one, given, "tau") / gains) for one in (arm, both)
    )
    guess = replace(arm, held_object=hf.HeldObject.box(1.0, 0.3, 0.2, 0.2))
    kinds = ["payload", "drive_gain"]
    found = hf.identify(guess, [first, replace(second, added=weight)], by="current", unknowns=kinds)
    assert np.allclose(found.others["drive_gain"], gains, rtol=1e-3)
    assert found.held_object.mass == pytest.approx(2.0, rel=1e-2)


@pytest.mark.slow
def test_forces_at_wrists_without_moments():
    """Offsets and drifts of two sensors, from forces, with a known weight in the second recording."""
    chain, state = two_pandas()
    first = recorded(chain, state, duration=5.0, rate=8.0, tau=False)
    heavy = hf.HeldObject(5.0, BOX.inertia, com=BOX.com * 3.0 / 5.0)
    second = recorded(replace(chain, held_object=heavy), state, duration=5.0, rate=8.0, tau=False)
    offset, drift = np.linspace(-3.0, 3.0, 6), 0.2

    def felt(one: Recording, **more: object) -> Recording:
        assert one.wrist_wrench is not None
        force = one.wrist_wrench[..., 3:].reshape(len(one), 6)
        read = (force + offset + drift * (one.t - one.t[0])[:, None]).reshape(-1, 2, 3)
        return replace(one, wrist_wrench=None, wrist_force=read, **more)

    added = hf.HeldObject(2.0, np.eye(3) * 1e-6)
    kinds = ["payload", "sensor_offset", "sensor_drift"]
    found = hf.identify(chain, [felt(first), felt(second, added=added)], by="wrist_force", unknowns=kinds)
    assert found.held_object.mass == pytest.approx(3.0, rel=0.02)
    assert np.allclose(found.held_object.com, BOX.com, atol=0.01)
    assert any("sensor offset" in name for name in found.partly)  # only the sum of those of two rigid hands is told


def test_scales_of_a_sensor_need_a_known_weight():
    """One arm whose sensor reads too much or too little along each axis."""
    chain = hf.ClosedChain({"arm": panda()}, BOX, {"arm": hf.Grasp("rigid", hf.Pose.translation(0, 0, 0.1))})
    added = hf.HeldObject(2.0, np.eye(3) * 1e-6)
    heavy = replace(chain, held_object=hf.HeldObject(5.0, BOX.inertia, com=BOX.com * 3.0 / 5.0))
    given, scale = replace(swung(30), wrist_force=np.zeros((30, 1, 3))), np.array([0.9, 1.05, 1.2])
    first, second = (
        replace(given, wrist_force=-measurement_errors(one, given, "wrist_force").reshape(-1, 1, 3) / scale)
        for one in (chain, heavy)
    )
    guess, kinds = replace(chain, held_object=hf.HeldObject.box(1.0, 0.2, 0.2, 0.2)), ["payload", "sensor_scale"]
    found = hf.identify(guess, [first, replace(second, added=added)], by="wrist_force", unknowns=kinds)
    assert np.allclose(found.others["sensor_scale"], scale, atol=1e-3)
    assert found.held_object.mass == pytest.approx(3.0, rel=1e-3)


def test_time_between_torques_and_positions():
    """Torques that were measured 6 ms late tell so."""
    late = replace(swung(200), t=np.linspace(0.0, 4.0, 200))
    assert late.tau is not None
    shifted = np.column_stack([np.interp(late.t - 0.006, late.t, column) for column in late.tau.T])
    found = hf.identify(BARE, replace(late, tau=shifted), by="tau", unknowns=["time_offset", "friction_offset"])
    assert found.others["time_offset"][0] == pytest.approx(0.006, abs=5e-4)


@pytest.mark.slow
def test_huber_keeps_outliers_from_the_estimate():
    """Torques of which some are absurd give friction all the same."""
    given, random = rubbing(), np.random.default_rng(3)
    assert given.tau is not None
    tau = given.tau + 0.02 * random.normal(size=given.tau.shape)
    tau[::12] += 30.0
    kinds = ["armature", "damping", "friction", "friction_offset"]
    off = {}
    for loss in ("squares", "huber"):
        found = hf.identify(BARE, replace(given, tau=tau), by="tau", unknowns=kinds, loss=loss)
        off[loss] = np.abs([j.friction for j in found.chain.arms["arm"].joints] - COULOMB).max()
    assert off["huber"] < 0.1 < off["squares"]


def test_what_stands_still_says_nothing_about_friction():
    """Without motion, friction and armature stay at the model's values and are named; no number is claimed."""
    given = swung(20, 0.0)
    found = hf.identify(BARE, given, by="tau", unknowns=["armature", "friction", "links"])
    joints = found.chain.arms["arm"].joints
    assert all(
        j.armature == pytest.approx(0.0, abs=1e-9) and j.friction == pytest.approx(0.0, abs=1e-9) for j in joints
    )
    named = set(found.kept)
    assert all(f"arm/joint{k} armature" in named and f"arm/joint{k} friction" in named for k in range(1, 8))
    assert "cannot be told from noise" in found.undetermined[0]
    assert np.isinf([found.deviations[name] for name in found.kept + found.partly]).all()


def test_links_stay_possible_and_at_the_prior_where_nothing_is_told():
    """Links whose torques are those of other ones fit, are possible, and do not leave the prior by much."""
    given, links = swung(40), panda().links
    heavier = panda()
    heavier = replace(heavier, links=[*links[:5], replace(links[5], mass=1.3 * links[5].mass), links[6]])
    truth = hf.ClosedChain({"arm": heavier})
    tau = -measurement_errors(truth, replace(given, tau=np.zeros((40, 7))), "tau")
    found = hf.identify(BARE, replace(given, tau=tau), by="tau", unknowns=["links"], prior=Prior(links=0.3))
    assert np.abs(found.errors).max() < 0.05 * np.abs(tau).max()
    assert all(is_feasible(inertial_parameters(link)) for link in found.chain.arms["arm"].links)
    first = found.chain.arms["arm"].links[0]
    assert first.mass == pytest.approx(links[0].mass, rel=0.05)
    assert "combinations of the links' parameters are determined" in found.undetermined[-1]


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"unknowns": ["frition"]}, ModelError, "expected names among"),
        ({"unknowns": []}, ModelError, "at least one"),
        ({"unknowns": ["payload"]}, ModelError, "an arm that holds the object"),
        ({"unknowns": ["drive_gain"]}, ModelError, "by='current'"),
        ({"unknowns": ["friction"], "by": "current"}, StateError, "expected current"),
        ({"unknowns": ["friction"], "by": "wrists"}, ModelError, "by: expected"),
        ({"unknowns": ["sensor_offset"], "by": "wrist_force"}, ModelError, "try by='tau'"),
        ({"unknowns": ["friction"], "gravity": True}, ModelError, "gravity"),
        ({"unknowns": ["friction"], "loss": "cauchy"}, ModelError, "loss"),
        ({"unknowns": ["friction"], "prior": Prior(friction=[1.0, 2.0])}, ModelError, "one number or 7"),
    ],
)
def test_what_cannot_be_asked_is_refused(given, error, said):
    """Messages say what was expected."""
    with pytest.raises(error, match=said):
        hf.identify(BARE, rubbing(), **({"by": "tau"} | given))
    with pytest.raises(ModelError, match="unknowns="):
        hf.identify(BARE, rubbing(), by="tau", prior=Prior())


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda x: {"tau": x["tau"] * np.where(np.arange(7) == 1, -1.0, 1.0)}, "tau of 'arm/joint2' has most likely"),
        (
            lambda x: {"tau": x["tau"][:, [0, 3, 2, 1, 4, 5, 6]]},
            "'arm/joint2' and 'arm/joint4' are most likely swapped",
        ),
        (lambda x: {"tau": 1e3 * x["tau"]}, "most likely it is not in N m"),
        (
            lambda x: {"tau": x["tau"] * (np.arange(7) != 3)},
            "'arm/joint4' is always 0; most likely it was not recorded",
        ),
        (lambda x: {"q": np.degrees(x["q"])}, "rad, beyond its limits; most likely they are degrees"),
        (lambda x: {"qd": np.degrees(x["qd"])}, "degrees per second"),
    ],
)
def test_likely_faults_of_recordings_are_named(fault, said):
    """Notes name the column and the cause; a right recording has none of them."""
    given = swung()
    wrong = replace(given, **fault({name: getattr(given, name) for name in ("q", "qd", "tau")}))
    notes = hf.identify(BARE, wrong, by="tau", unknowns=["friction"]).notes
    assert any(said in note for note in notes), notes
    right = hf.identify(BARE, given, by="tau", unknowns=["friction"]).notes
    assert not any("most likely" in note for note in right)


def test_torques_of_an_arm_that_stands_are_constant_and_recorded():
    """Positions that differ by rounding are no motion, in which a torque would have to change."""
    still = np.tile(HOME["panda"], (20, 1)) + 1e-15 * np.random.default_rng(0).normal(size=(20, 7))
    given = Recording(t=np.arange(20) / 100, q=still, qd=0 * still, qdd=0 * still, tau=0 * still)
    tau = -measurement_errors(BARE, given.part(slice(0, 1)), "tau")
    notes = hf.identify(BARE, replace(given, tau=np.tile(tau, (20, 1))), by="tau", unknowns=["friction"]).notes
    assert not any("not recorded" in note for note in notes), notes


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"tau": np.full((20, 7), np.nan)}, "recording: tau"),
        ({"t": np.zeros(20)}, "increasing times"),
        ({"tau": np.zeros((20, 6))}, "recording: tau"),
        ({"q": np.zeros((19, 7))}, "recording: q"),
    ],
)
def test_faults_of_recordings_are_refused(fault, said):
    """Numbers that are not finite, repeated stamps and wrong lengths raise an error with the column's name."""
    given = {"t": np.arange(20.0), "q": np.zeros((20, 7)), "tau": np.zeros((20, 7))}
    with pytest.raises(StateError, match=said):
        Recording(**(given | fault))


@pytest.mark.slow
def test_noise_of_positions_enters_deviations_also_where_that_of_torques_is_given():
    """Encoders whose noise is most of what accelerations have: errors are as deviations say; they were 20 times these.

    Squares of errors in units of deviations have the mean 1 if these are right, and were 580 for the last friction.
    """
    at = [hf.Pose.translation(0.0, 0.0, z) for z in (0.0, 0.4, 0.4)]
    joints = [hf.Joint(axis=axis, placement=one, damping=0.3, friction=0.5)
              for axis, one in zip(([0, 0, 1], [0, 1, 0]), at, strict=False)]  # fmt: skip
    links = [hf.Link(2.0, [0.01, 0.0, 0.2], np.diag([0.03, 0.03, 0.005]))] * 2
    box = hf.HeldObject(2.0, np.diag([0.02, 0.05, 0.04]), [0.02, 0.0, 0.03])
    chain = hf.ClosedChain({"arm": hf.Arm(joints, links, at[2])}, box, {"arm": hf.Grasp("rigid", hf.Pose.identity())})
    t = np.linspace(0.0, 4.0, 160)
    x, size = np.array([2.0, 3.1]) * t[:, None] + [0.0, 1.0], 0.6
    w = np.array([2.0, 3.1])
    exact = Recording(t=t, q=size * np.sin(x), qd=size * w * np.cos(x), qdd=-size * w**2 * np.sin(x), tau=0.0 * x)
    tau = -hf.identification.measurement_errors(chain, exact, "tau")
    right = {f"arm/joint{k} {kind}": value for k in (1, 2) for kind, value in (("damping", 0.3), ("friction", 0.5))}
    model = replace(chain, held_object=hf.HeldObject.box(1.0, 0.2, 0.2, 0.2))
    squares = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        noisy = Recording(
            t=t, q=exact.q + 1e-3 * random.normal(size=x.shape), tau=tau + 0.02 * random.normal(size=x.shape)
        )
        found = hf.identify(model, noisy, by="tau", unknowns=["payload", "damping", "friction"], noise=0.02)
        of = [found.names.index(name) for name in right]
        squares.append((found.values[of] - list(right.values())) ** 2 / np.diag(found.covariance)[of])
        assert any("positions have noise of up to" in note for note in found.notes)
    assert 0.1 < np.mean(squares) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("held", ["two", "one", "none"])
def test_machine_code_of_many_samples_gives_the_equations_of_a_few(held, monkeypatch):
    """Rows are bases of the same motions: as errors of the measurements, which no basis enters, they are equal."""
    if held == "two":
        chain, state = two_pandas()
        given = recorded(chain, state, duration=1.0, rate=8.0)
    else:
        chain, given = without_object(BARE), rubbing().part(slice(0, 8))
        if held == "one":
            chain = hf.ClosedChain({"arm": panda()}, BOX, {"arm": hf.Grasp("rigid", hf.Pose.translation(0, 0, 0.1))})
            given = moving(chain, [given])[0]
    kinds = ("links", *OF_JOINTS) if held == "none" else ("payload", "links", *OF_JOINTS)
    assert given.tau is not None
    unknowns = machine_unknowns(chain, "tau", kinds, Prior(), given.tau, np.ones(given.tau.shape[1]), 1.0)
    one = np.ones(given.tau.shape[1])
    (few,) = forces_without_friction(chain, [given], unknowns, one)
    monkeypatch.setattr(instants, "MANY", 1)
    _, many = forces_without_friction(chain, [given, given], unknowns, one)
    assert np.allclose(few, many, rtol=0.0, atol=1e-10 * np.abs(few).max())
