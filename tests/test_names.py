"""Names that are not there, and calls whose arguments do not fit: errors of ours that give the nearest name."""

import inspect
import pickle
import subprocess
import sys

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import CallError, StateError, UnknownName
from holdfast.identification.feasible_bodies import is_feasible
from holdfast.names import called, did_you_mean
from tests.fuzz.calls import fixed
from tests.surface import THEMES


def test_nearest_name():
    """In any case of letters, or all names where none is near."""
    assert did_you_mean("Gian", ["gain", "mass"]) == " Did you mean 'gain'? Known: gain, mass."
    assert did_you_mean("xyz", ["gain", "mass"]) == " Known: gain, mass."
    assert did_you_mean("squeeze", ["size", "internal_force"]) == " Did you mean 'internal_force'?"  # renamed
    assert did_you_mean("squeeze", ["gain"]) == " Known: gain."


@pytest.mark.parametrize("room", [*(theme for theme in THEMES if theme not in ("plot", "world")), "view", ""])
def test_names_are_listed_before_first_use(room):
    """`dir` of a package that nobody has used lists what its stub names, and nothing else."""
    name = f"holdfast.{room}".rstrip(".")
    code = f"import importlib; m = importlib.import_module('{name}'); print(*dir(m)); print(*m.__all__)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    listed, public = run.stdout.splitlines()
    stub = (sys.modules["holdfast"].__path__[0] + f"/{room}/__init__.pyi").replace("//", "/")
    with open(stub, encoding="utf-8") as text:
        named = [line.split()[-1] for line in text if line.startswith("from ")]
    assert listed.split() == public.split() == sorted(named)


MISSPELT = {
    "foward_dynamics": "holdfast has no 'foward_dynamics'. Did you mean 'forward_dynamics'?",
    "dynamics.jacobain": "holdfast.dynamics has no 'jacobain'",
    "robots.pandas": "holdfast.robots has no 'pandas'. Did you mean 'panda'?",
    "view.save_plot": "holdfast.view has no 'save_plot'. Did you mean 'save_plots'?",
    "control.GravityCompensaton": "Did you mean 'GravityCompensation'?",
    "gym.CaryTask": "Did you mean 'CarryTask'?",
}


@pytest.mark.parametrize("path", MISSPELT)
def test_misspelt(path):
    """It is an AttributeError too, so that `hasattr` works."""
    room, _, name = path.rpartition(".")
    package = getattr(hf, room) if room else hf
    with pytest.raises(UnknownName) as refused:
        getattr(package, name)
    assert MISSPELT[path] in str(refused.value) and isinstance(refused.value, AttributeError)
    assert not hasattr(package, name)


def test_names_of_several_lines():
    """The message stays on one, however long the name is."""
    with pytest.raises(UnknownName) as refused:
        getattr(hf, "forward\ndynamics" + "s" * 1000)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 1000


def test_errors_have_one_home():
    """Whoever looks for one at the top is told where it is."""
    with pytest.raises(UnknownName, match=r"holdfast has no 'StateError'; try holdfast.errors.StateError"):
        hf.StateError  # noqa: B018


@called
def two(a, b=1.0, *, c):
    """Return a sum."""
    return a + b + c


WRONG = {
    "unknown": (lambda: two(1.0, c=1.0, d=2.0), "two: no argument 'd'"),
    "missing": (lambda: two(1.0), "two: expected c too, got no value (given by order: a: float); try c=..."),
    "surplus": (lambda: two(1.0, 2.0, 3.0, c=1.0), "two: expected at most 2 arguments without names in the order a, b"),
    "twice": (lambda: two(1.0, a=2.0, c=1.0), "two: expected a once"),
    "of a simulation": (
        lambda: hf.simulate(fixed().chain, fixed().state, None, duration=0.1, stepp=0.01),
        "simulate: no argument 'stepp'. Did you mean 'step'?",
    ),
    "of a state": (lambda: hf.State(fixed().state.q), "State: expected qd too"),
    "of a law": (lambda: hf.ControlLaw(lambda *x: x, parameter={}), "Did you mean 'parameters'?"),
    "of a constructor by name": (
        lambda: hf.HeldObject.box(mass=1.0, size=[1.0, 1.0, 1.0]),
        "HeldObject.box: no argument 'size'. Known: mass, x, y, z.",
    ),
    "of a pose": (lambda: hf.Pose([0.0, 0.0, 0.0]), "Pose: expected p too, got no value (given by order: R: list)"),
    "of a value's class": (
        lambda: hf.Grasp("softfinger", friction=hf.Friction(0.5)),
        "Grasp: no argument 'friction'. Did you mean 'contact'?",
    ),
    "of a law's call": (lambda: hf.ControlLaw(lambda *x: x)(0.0), "ControlLaw: expected state, memory too"),
    "of a law's renamed gain": (
        lambda: hf.control.GravityCompensation(fixed().chain, squeeze=1.0),
        "GravityCompensation: no argument 'squeeze'. Did you mean 'internal_force'?",
    ),
    "renamed": (
        lambda: hf.holding_torques(fixed().chain, fixed().state, internal=1.0),
        "holding_torques: no argument 'internal'. Did you mean 'internal_force'?",
    ),
    "of a regulator": (lambda: hf.linearise(fixed().chain, fixed().state), "linearise: expected tau too"),
    "of a built-in arm": (lambda: hf.robots.panda(bas=1), "panda: no argument 'bas'. Did you mean 'base'?"),
    "of a task": (lambda: hf.gym.CarryTask(fixed().chain, pth=1), "CarryTask: no argument 'pth'. Did you mean 'path'?"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_calls(what):
    """They are TypeErrors too."""
    call, message = WRONG[what]
    with pytest.raises(CallError) as refused:
        call()
    assert message in str(refused.value) and "\n" not in str(refused.value) and isinstance(refused.value, TypeError)


def test_a_function_s_own_error():
    """A TypeError from inside is passed on as it is."""
    with pytest.raises(TypeError, match="can only concatenate") as raised:
        two("x", 1, c=None)
    assert not isinstance(raised.value, hf.HoldfastError)


def test_functions_stay_what_they_are():
    """Signature, name, and the way through a pickle."""
    assert [*inspect.signature(hf.linearise).parameters][:3] == ["chain", "state", "tau"]
    assert pickle.loads(pickle.dumps(hf.linearise)) is hf.linearise
    assert hf.linearise.__module__ == "holdfast.simulation.linearise"
    assert sys.modules["holdfast.simulation.linearise"].linearise is hf.linearise


def test_attributes():
    """An object names the nearest attribute; a property's own error comes through; Python's questions are answered."""
    state = fixed().state
    with pytest.raises(UnknownName, match=r"no attribute 'object_pos'.* mean 'object_pose'"):
        _ = state.object_pos  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"'State' object has no attribute '_x'$"):
        _ = state._x  # type: ignore[attr-defined]

    @called
    class Failing:
        @property
        def whole(self):
            return np.zeros(3).none  # type: ignore[attr-defined]

    with pytest.raises(AttributeError, match=r"numpy\.ndarray"):
        _ = Failing().whole


def test_a_failure_of_linear_algebra():
    """Within this package it is an error of ours, at the name that was called; a caller's function keeps its own."""
    far = np.full((3, 3), np.inf)
    ours = called(is_feasible)
    with np.errstate(all="ignore"), pytest.raises(StateError, match="is_feasible: expected numbers of") as refused:
        ours(np.array([1.0, *np.full(9, np.inf)]))
    assert isinstance(refused.value.__cause__, np.linalg.LinAlgError)

    @called
    def asked(function):
        return function()

    with pytest.raises(np.linalg.LinAlgError):
        asked(lambda: np.linalg.svd(far))
