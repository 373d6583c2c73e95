"""Identification: exact from exact recordings, near from noisy ones, honest about both, in words where it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

import holdfast as hf
from holdfast.identification import Recording
from holdfast.identification.equations import equations
from holdfast.identification.estimate import estimate
from holdfast.identification.payload_unknowns import Settings, unknowns_of
from tests.identification.recorded import BOX, noisy, recorded, two_pandas
from tests.longer import mostly_slow

TRUE = np.r_[BOX.mass, BOX.com, BOX.inertia[np.triu_indices(3)]]
GUESS = hf.HeldObject.box(2.4, 0.3, 0.3, 0.3)  # a fifth lighter, its mass centre 54 mm off
BY = ["wrist_wrench", "tau"]


@pytest.fixture(scope="module")
def model() -> hf.ClosedChain:
    """Return the chain as it is thought to be."""
    return replace(two_pandas()[0], held_object=GUESS)


@pytest.fixture(scope="module")
def swung() -> Recording:
    """Return ten seconds of two arms, fifty samples a second."""
    return recorded(*two_pandas(), rate=50.0)


@pytest.fixture(scope="module")
def short() -> Recording:
    """Return the same with five samples a second."""
    return recorded(*two_pandas(), rate=5.0)


def given(recording: Recording) -> dict[str, np.ndarray]:
    """Return the arrays of a recording that were recorded."""
    arrays = {name: getattr(recording, name) for name in Recording.__dataclass_fields__ if name != "inputs"}
    return {name: x for name, x in arrays.items() if x is not None}


def far(found: hf.identification.Identification) -> float:
    """Return the chi-square of the error of the payload, where it is told."""
    off = (found.values[:10] - TRUE) / np.sqrt(np.diag(found.covariance)[:10])
    sizes = np.sqrt(np.diag(found.covariance)[:10])
    return float(off @ np.linalg.solve(found.covariance[:10, :10] / np.outer(sizes, sizes), off))


@pytest.mark.slow
@pytest.mark.parametrize("by", BY)
def test_exact(model, short, by):
    """Without noise the payload comes back, however wrong the model is."""
    found = hf.identify(model, short, by=by)
    assert np.abs(found.values - TRUE).max() < 1e-8
    assert found.undetermined == found.notes == found.kept == ()
    assert found.held_object.mass == found.values[0]
    assert np.abs(found.residuals).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("by", BY)
@pytest.mark.parametrize("seeds", [25, pytest.param(400, marks=pytest.mark.long)])
def test_noisy_recordings(model, swung, by, seeds):
    """Five per cent of noise: mass to half a per cent, mass centre to 2 mm; nine of ten errors are in their region."""
    settings = Settings(by, False, False)
    system = equations(model, [swung], settings)
    unknowns = unknowns_of(model, settings, np.ones(6))
    kinds = np.tile([0] * 3 + [1] * 3, 2) if by == BY[0] else np.arange(14)
    errors, distances = [], []
    for seed in range(seeds):
        measured = getattr(noisy(swung, seed), by).reshape(len(swung), -1)
        rows = system.rows.copy()
        rows[..., -1] -= np.einsum("src,sc->sr", system.maps, measured - system.measured)
        found = estimate(replace(system, rows=rows, measured=measured), unknowns, kinds, None, 0.3)
        assert not found.fixed.size
        error = found.plain - TRUE
        errors.append(error)
        scale = np.sqrt(np.diag(found.covariance))
        distances.append(error / scale @ np.linalg.solve(found.covariance / np.outer(scale, scale), error / scale))
    errors = np.array(errors)
    assert np.median(np.abs(errors[:, 0])) < 0.005 * BOX.mass
    assert np.median(np.linalg.norm(errors[:, 1:4], axis=1)) < 2e-3
    within = int((np.array(distances) < chi2.ppf(0.9, 10)).sum())
    assert (
        binom.ppf(0.001, seeds, 0.88) <= within <= binom.ppf(0.999, seeds, 0.9)
    )  # 0.88: of a covariance estimated too
    assert np.mean(distances) == pytest.approx(10.3, abs=4 * np.sqrt(20 / seeds))  # 10 of a covariance that is known


@pytest.mark.slow
@pytest.mark.parametrize("by", mostly_slow(BY, ("tau",)))
def test_the_rows_as_they_are_called(model, swung, by):
    """One of these by the public function: the same noise gives the same, and the region holds the truth."""
    found = hf.identify(model, noisy(swung, 3), by=by)
    assert abs(found.values[0] - 3.0) < 4 * found.deviations["mass"] < 0.1
    assert far(found) < chi2.ppf(0.999, 10)
    assert found.misfit == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_without_turning(model):
    """Of a box that is shifted and not turned the inertia cannot be told: the model's stays, and is named."""
    found = hf.identify(model, noisy(recorded(*two_pandas(), rate=10.0, turn=0.0, tau=False), 0))
    moments = tuple(f"inertia {axes}" for axes in ("xx", "xy", "xz", "yy", "yz", "zz"))
    assert found.kept == moments
    assert "cannot be told from noise: inertia xx, inertia xy" in found.undetermined[0]
    assert np.abs(found.held_object.inertia - GUESS.inertia).max() < 1e-6
    assert abs(found.values[0] - 3.0) < 0.03
    assert np.linalg.norm(found.values[1:4] - BOX.com) < 5e-3
    assert all(found.deviations[name] == np.inf for name in moments)
    assert "inertia zz" in str(found) and "from the guess" in str(found)


def test_standing_still(model):
    """At rest in one configuration the mass and the mass centre's part across the weight are told, along it nothing."""
    still = recorded(*two_pandas(), duration=2.0, rate=50.0, turn=0.0, shift=0.0, tau=False)
    found = hf.identify(model, noisy(still, 1))
    R, down = hf.Pose.from_wxyz_xyz(still.object_pose[0]).R, np.array([0.0, 0.0, 1.0])
    off = R @ (found.values[1:4] - BOX.com)
    assert np.linalg.norm(off - off @ down * down) < 5e-3
    along = R @ (found.values[1:4] - GUESS.com) @ down
    assert abs(along) < 1e-6
    assert abs(found.values[0] - 3.0) < 0.1
    assert len(found.kept) == 6 and len(found.partly) == 3  # the weight acts along none of the object's axes
    assert any("com" in sentence for sentence in found.undetermined)


def test_several_recordings(model, short):
    """Halves of a recording are the recording; their order does not matter."""
    arrays = given(short)
    halves = [Recording(**{name: x[part] for name, x in arrays.items()}) for part in (slice(25, None), slice(25))]
    found, whole = hf.identify(model, halves), hf.identify(model, short)
    assert np.abs(found.values - whole.values).max() < 1e-9


@pytest.mark.slow
def test_offsets_of_sensors(model, swung):
    """What two sensors show too much together is told; which of two that hold one body rigidly shows it is not."""
    offsets = np.array([[0.1, -0.2, 0.3, 1.0, 2.0, -3.0], [0.0, 0.1, 0.0, 0.5, 0.0, 1.0]])
    shown = noisy(swung, 4)
    shown = replace(shown, wrist_wrench=shown.wrist_wrench + offsets)
    found, wrong = hf.identify(model, shown, sensor_bias=True), hf.identify(model, shown)
    assert abs(wrong.values[0] - 3.0) > 10 * abs(found.values[0] - 3.0)
    assert far(found) < chi2.ppf(0.999, 10)

    def together(b: np.ndarray) -> np.ndarray:
        """Return the sum about C, object axes, by the grasps' frames."""
        frames = [grasp.frame for grasp in model.grasps.values()]
        forces = [at.R @ one[3:] for at, one in zip(frames, b, strict=True)]
        moments = [at.R @ one[:3] + np.cross(at.p, f) for at, one, f in zip(frames, b, forces, strict=True)]
        return np.r_[sum(moments), sum(forces)]

    assert found.sensor_bias is not None
    assert np.abs(together(found.sensor_bias) - together(offsets)).max() < 0.3
    assert len(found.undetermined) == 6
    assert all(found.deviations[name] == np.inf for name in found.names[10:])


@pytest.mark.parametrize("by", mostly_slow(BY, BY[:1]))
def test_tilted_gravity(model, short, by):
    """The arms stand on a floor that is tilted by three degrees, and the model thinks it level."""
    chain, state = two_pandas()
    g = 9.81 * np.array([np.sin(0.05), 0.02, -np.cos(0.05)])
    g *= 9.81 / np.linalg.norm(g)
    tilted = recorded(replace(chain, gravity=g), state, rate=5.0)
    found = hf.identify(model, tilted, by=by, gravity=True)
    assert np.abs(found.gravity - g).max() < 1e-7
    assert np.abs(found.values[:10] - TRUE).max() < 1e-7


def test_grasp_frames(model, short):
    """The right hand holds 8 mm beside where the model has it; with the object's pose both frames are found."""
    grasp = model.grasps["right"]
    beside = replace(
        grasp, frame=hf.Pose.from_rpy(0.01, 0, 0.02, [0.008, -0.15, 0.002]) @ hf.Pose(grasp.frame.R, np.zeros(3))
    )
    wrong = replace(model, grasps={**model.grasps, "right": beside})
    for given in (short, replace(short, object_pose=None)):
        found = hf.identify(wrong, given, grasp_frames=True)
        frame = found.chain.grasps["right"].frame
        assert np.abs(frame.p - grasp.frame.p).max() < 1e-9
        assert np.abs(frame.R - grasp.frame.R).max() < 1e-9
        assert np.abs(found.values - TRUE).max() < 1e-6
        assert found.grasp_deviations["right"].max() < 1e-9
        assert bool(found.notes) == (given.object_pose is None)  # the left frame says where the object is
    unaware = hf.identify(wrong, short)
    assert "'right' 0.02" in unaware.notes[-1] and "grasp_frames=True" in unaware.notes[-1]


@pytest.mark.slow
def test_what_is_not_recorded(model):
    """Rates and accelerations from positions, and the object's motion from the tips."""
    whole = recorded(*two_pandas(), duration=1.0, rate=100.0, tau=False)
    less = replace(whole, object_pose=None, object_twist=None, object_acceleration=None)
    assert np.abs(hf.identify(model, less).values - TRUE).max() < 1e-7
    # the arms' null motions of these recordings are of their own making: the tips alone are smooth
    bare = replace(less, qd=None, qdd=None)
    inner = hf.identify(model, bare)
    assert abs(inner.values[0] - 3.0) < 0.01
    assert np.linalg.norm(inner.values[1:4] - BOX.com) < 2e-3


def test_given_noise(model, short):
    """Of noise that is known the deviations are those of the weights; of too little noise a note says so."""
    w = short.wrist_wrench
    known = 0.05 * np.repeat([np.sqrt((w[..., half] ** 2).mean()) for half in (slice(0, 3), slice(3, 6))], 3)
    shown = noisy(short, 5)
    found, estimated = hf.identify(model, shown, noise=known), hf.identify(model, shown)
    assert found.notes == ()
    assert far(found) < chi2.ppf(0.999, 10)
    assert found.deviations["mass"] == pytest.approx(estimated.deviations["mass"], rel=0.5)
    assert "times the given noise" in hf.identify(model, shown, noise=known / 5).notes[0]


@pytest.mark.slow
def test_correlated_noise(model, swung):
    """Noise that lasts for several samples is seen, and widens the deviations."""
    rng, w = np.random.default_rng(2), swung.wrist_wrench
    white, lasting = rng.normal(size=w.shape), np.zeros(w.shape)
    for k in range(1, len(w)):
        lasting[k] = 0.9 * lasting[k - 1] + np.sqrt(1 - 0.81) * white[k]
    lasts, independent = (hf.identify(model, replace(swung, wrist_wrench=w + noise / 10)) for noise in (lasting, white))
    assert any("correlated (0.9" in note or "correlated (0.8" in note for note in lasts.notes)
    assert independent.notes == ()
    assert lasts.deviations["mass"] > 2 * independent.deviations["mass"]


def test_always_a_feasible_body(model, short):
    """Noise as large as the moments: the rows ask for an impossible inertia, and a possible one is given, and said."""
    rng = np.random.default_rng(3)
    w = short.wrist_wrench + rng.normal(size=short.wrist_wrench.shape) * [0.3, 0.3, 0.3, 1.5, 1.5, 1.5]
    found = hf.identify(model, replace(short, wrist_wrench=w), largest_deviation=1e9)
    moments = np.linalg.eigvalsh(found.held_object.inertia)
    assert moments[0] > 0.0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-9)
    assert "not a feasible body" in found.notes[0]


REFUSED = {
    "chain: expected ClosedChain": {"chain": 1},
    "by: expected 'wrist_wrench' or 'tau'": {"by": "force"},
    "sensor_bias: expected bool": {"sensor_bias": 1},
    "torques do not show it": {"by": "tau", "sensor_bias": True},
    "noise: expected shape": {"noise": [1.0, 2.0]},
    "noise: expected standard deviations > 0": {"noise": [0.0] * 6},
    "at least one, got none": {"recordings": []},
    "largest_deviation: expected > 0": {"largest_deviation": 0.0},
    "run: expected Trajectory": {"recordings": 3},
    "path": {"recordings": "nowhere.csv"},
}


@pytest.mark.parametrize("said", REFUSED)
def test_refusals(model, short, said):
    """By name, and as errors of this library."""
    with pytest.raises(hf.HoldfastError, match=said if said != "path" else "nowhere"):
        hf.identify(**{"chain": model, "recordings": short} | REFUSED[said])


@pytest.mark.parametrize("by", BY)
def test_degrees_are_named(model, short, by):
    """Positions in degrees are said before a mass below zero, or beside a bad fit."""
    wrong = replace(short, q=np.degrees(short.q))
    try:
        said = "; ".join(hf.identify(model, wrong, by=by).suspicions)
    except hf.errors.StateError as error:
        said = str(error)
        assert said.index("degrees") < said.index("as it stands")
    assert "q of 'left/joint1'" in said and "degrees" in said


def test_recordings_that_do_not_fit(model, short):
    """Lacking, too few, of other arms, or of no motion that could tell anything."""
    few = {name: x[:2] for name, x in given(short).items()}
    for wrong, said in (
        (replace(short, wrist_wrench=None), "expected wrist_wrench, got none; it has tau"),
        (replace(short, wrist_wrench=short.wrist_wrench[:, :1]), "expected 2 arms, got 1"),
        (Recording(**few), "expected 20 rows or more for 10 unknowns, got 12 of 2 samples"),
        (Recording(short.t, short.q[:, :7], wrist_wrench=short.wrist_wrench), "expected 14 joints, got 7"),
    ):
        with pytest.raises(hf.errors.StateError, match=said):
            hf.identify(model, wrong)
    with pytest.raises(hf.errors.StateError, match="increasing"):
        replace(short, t=short.t[::-1])
    with pytest.raises(hf.errors.StateError, match="qd: expected shape"):
        replace(short, qd=short.qd[1:])
    floating = replace(model, gravity=np.zeros(3))
    with pytest.raises(hf.errors.ModelError, match="gravity"):
        hf.identify(floating, short, gravity=True)
    weightless = Recording(
        short.t,
        np.tile(short.q[0], (len(short), 1)),
        **{name: 0 * getattr(short, name) for name in ("qd", "qdd", "object_twist", "object_acceleration")},
        wrist_wrench=np.random.default_rng(0).normal(size=short.wrist_wrench.shape),
        object_pose=np.tile(short.object_pose[0], (len(short), 1)),
    )
    with pytest.raises(hf.errors.StateError, match="identifies some part of the payload"):
        hf.identify(floating, weightless)
    flat = replace(model, held_object=hf.HeldObject(1.0, np.diag([1.0, 1.0, 2.0])))
    with pytest.raises(hf.errors.ModelError, match="flat"):
        hf.identify(flat, short)
