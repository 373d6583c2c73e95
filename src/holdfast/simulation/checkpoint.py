"""Everything a run needs to go on, bit for bit as if it had never been left.

`simulate(..., on_checkpoint=keep)` hands out one `Checkpoint` right after every sample (after
`on_sample` had that sample). `simulate(..., start=checkpoint)`, called with the same chain,
controller, duration, step and options as the first time, then yields exactly the samples that
come after that sample: the arrays of the first part, followed by those of the second, are those
of an unbroken run. The state that `simulate` asks for is not used then.

On disk a checkpoint is two flat things: arrays by name, for an .npz, and plain data, for JSON
(no digit is lost in text):

    arrays, data = checkpoint.to_data()
    checkpoint = Checkpoint.from_data(arrays, data)

What happened on the way (grasps closed, opened, slipped; limits passed) is kept twice: each sample
carries its own `occurrences` beside its arrays, and `stacked` joins them; a checkpoint has all of them
since the start, so that the log of a run that was killed is whole too.

The chain itself is not in it: what a scene says comes from the scene. Only the grasps are, since
arms attach and release during a run. A controller's memory may hold None, truth values, integers,
floats, texts, NumPy arrays of these, and tuples, lists and dicts (with text keys) of all that;
anything else is refused by name when a checkpoint is written, not when it is made, so a run that
is not saved may remember what it likes.


Plain memories (numbers, arrays, and tuples, lists, dicts of them) as arrays and JSON-able data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.simulation.adaptive import Proposal
from holdfast.simulation.balance import Sums
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.trajectory import Occurrence
from holdfast.simulation.zero_order_hold import HeldTorques
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State, exact_state

TRACKER = "ledger"  # what result folders call it


@dataclass(frozen=True, eq=False)
class Origin:
    """What an accepted instant was made from; evaluated again, it is that instant again.

    Attributes:
        t: time [s].
        state: positions and velocities.
        memory: what the controller was given (not what it returned).
    """

    t: float
    state: State
    memory: Any


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A run at one of its samples.

    Attributes:
        now: the sample's time, state and the memory given to the controller.
        previous: the same of the accepted instant before, from which a minimum of a margin about
            `now` is refined to the left; None where `now` begins a smooth stretch.
        tail_time: the last time before `now` at which margins were looked at [s].
        tail: the margins then; empty without `previous`.
        stop: how many of the times that steps must end at lie behind.
        event: how many events have happened.
        grasps: the grasps that are on the chain.
        generic_rank: of the chain with these grasps.
        implicit: whether steps are linearly implicit, see `Segment`.
        sums: what has gone into the chain since the start.
        occurrences: what has happened so far.
        proposal: what the step size control goes on with; None for steps of fixed size.
        tracker: margins so far.
        held: where a sampled controller is; None where it is asked all along.
    """

    now: Origin
    previous: Origin | None
    tail_time: float
    tail: Array
    stop: int
    event: int
    grasps: Mapping[str, Grasp]
    generic_rank: int
    implicit: bool
    sums: Sums
    occurrences: tuple[Occurrence, ...]
    proposal: Proposal | None
    tracker: ViolationTracker = field(repr=False)
    held: HeldTorques | None = None

    def to_data(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return arrays by name, and plain data that JSON can hold.

        Raises:
            ResultError: the controller remembers something that cannot be written; it is named.
        """
        arrays = {
            "tail_time": np.array(self.tail_time),
            "tail": self.tail,
            **{name: np.array(x) for name, x in self.sums._asdict().items()},
            "proposal": np.array([] if self.proposal is None else [self.proposal.step, self.proposal.last_error]),
            **{f"{TRACKER}.{f.name}": getattr(self.tracker, f.name) for f in fields(ViolationTracker)},
        }
        data: dict[str, Any] = {
            "stop": self.stop,
            "event": self.event,
            "generic_rank": self.generic_rank,
            "implicit": self.implicit,
            "occurrences": [asdict(one) for one in self.occurrences],
            "grasps": [_grasp_data(name, grasp, arrays) for name, grasp in self.grasps.items()],
            "now": _origin_data("now", self.now, arrays),
            "held": None if self.held is None else packed(vars(self.held), "held", arrays),
            "previous": None if self.previous is None else _origin_data("previous", self.previous, arrays),
        }
        return arrays, data

    @classmethod
    def from_data(cls, arrays: Mapping[str, Array], data: Mapping[str, Any]) -> Self:
        """Return the checkpoint of `to_data`.

        Raises:
            ResultError: something is missing or has another form.
        """
        try:
            previous = data["previous"]
            return cls(
                now=_origin("now", data["now"], arrays),
                previous=None if previous is None else _origin("previous", previous, arrays),
                tail_time=float(arrays["tail_time"]),
                tail=np.array(arrays["tail"]),
                stop=int(data["stop"]),
                event=int(data["event"]),
                grasps=dict(_grasp(given, arrays) for given in data["grasps"]),
                generic_rank=int(data["generic_rank"]),
                implicit=bool(data.get("implicit", False)),
                sums=Sums(np.array(arrays["work"]), float(arrays["impact"]), np.array(arrays["base_impulse"])),
                occurrences=msgspec.convert(data["occurrences"], tuple[Occurrence, ...]),
                proposal=Proposal(*arrays["proposal"].tolist()) if len(arrays["proposal"]) else None,
                held=_held(data.get("held"), arrays),
                tracker=ViolationTracker(*(np.array(arrays[f"{TRACKER}.{f.name}"]) for f in fields(ViolationTracker))),
            )
        except (KeyError, TypeError, ValueError, AttributeError, msgspec.ValidationError) as cause:
            raise ResultError(f"checkpoint: cannot be read: {cause!r}; try starting the run anew") from cause


_STATE = ("q", "qd", "object_pose", "object_twist", "base_pose", "base_twist")  # the last two of a floating base


def _origin_data(name: str, origin: Origin, arrays: dict[str, Array]) -> Any:
    parts = {part: getattr(origin.state, part) for part in _STATE}
    arrays |= {f"{name}.{part}": array for part, array in parts.items() if array is not None}
    arrays[f"{name}.t"] = np.array(origin.t)
    return packed(origin.memory, f"{name}.memory", arrays)


def _origin(name: str, memory: Any, arrays: Mapping[str, Array]) -> Origin:
    saved = {part: np.array(arrays[at]) for part in _STATE if (at := f"{name}.{part}") in arrays}
    return Origin(float(arrays[f"{name}.t"]), exact_state(saved), unpacked(memory, arrays))


def _held(data: Any, arrays: Mapping[str, Array]) -> HeldTorques | None:
    return None if data is None else HeldTorques(**unpacked(data, arrays))


_OF_GRASP = ("motion", "stiffness", "damping")  # the arrays that some kinds have


def _grasp_data(name: str, grasp: Grasp, arrays: dict[str, Array]) -> dict[str, Any]:
    arrays |= {f"grasps.{name}.R": grasp.frame.R, f"grasps.{name}.p": grasp.frame.p}
    own = {part: getattr(grasp, part) for part in _OF_GRASP}
    arrays |= {f"grasps.{name}.{part}": x for part, x in own.items() if x is not None}
    parts = {
        part: None if of is None else {f.name: getattr(of, f.name) for f in fields(of)}
        for part, of in (("contact", grasp.contact), ("wrench_limits", grasp.wrench_limits))
    }
    return {
        "arm": name,
        "kind": grasp.kind,
        "pitch": grasp.pitch,
        **{part: packed(parts[part], f"grasps.{name}.{part}", arrays) for part in parts},
    }


def _grasp(given: Mapping[str, Any], arrays: Mapping[str, Array]) -> tuple[str, Grasp]:
    name = given["arm"]
    frame = Pose(np.array(arrays[f"grasps.{name}.R"]), np.array(arrays[f"grasps.{name}.p"]))
    contact, limits = (unpacked(given[part], arrays) for part in ("contact", "wrench_limits"))
    return name, Grasp(
        given["kind"],
        frame,
        None if contact is None else Friction(**contact),
        None if limits is None else WrenchLimits(**limits),
        given.get("pitch"),
        *(arrays.get(f"grasps.{name}.{part}") for part in _OF_GRASP),
    )


_NUMBERS = {bool: "bool", int: "int", float: "float"}


def packed(value: Any, name: str, arrays: dict[str, Array]) -> Any:
    """Return what a value consists of, as plain data; its numbers go into the arrays.

    Args:
        value: None, a truth value, a number, a text, an array, or a tuple, list or dict of these.
        name: for messages, and part of the names of the arrays.
        arrays: where the numbers go.

    Raises:
        ResultError: naming what cannot be written, and where it is.
    """
    kind = type(value)
    if value is None or kind is str:
        return {"text": value}
    if kind in (tuple, list):
        return {kind.__name__: [packed(item, f"{name}[{i}]", arrays) for i, item in enumerate(value)]}
    if kind is dict and all(type(key) is str for key in value):
        return {"dict": {key: packed(item, f"{name}.{key}", arrays) for key, item in value.items()}}
    place = f"{name}:{len(arrays)}"  # numbered: keys may hold any letters
    if isinstance(value, np.ndarray | np.generic) and np.asarray(value).dtype.kind in "biufcU":
        arrays[place] = np.array(value)
        return {"array" if isinstance(value, np.ndarray) else "scalar": place}
    if type(value) in (bool, float) or (type(value) is int and abs(value) < 2**63):
        arrays[place] = np.array(value)
        return {_NUMBERS[kind]: place}
    raise ResultError(
        f"{name}: expected None, numbers (of 64 bits), texts, arrays, or tuples, lists and dicts (with text keys) of"
        f" them, got {kind.__name__}; try to remember these instead, or to simulate without saving"
    )


def unpacked(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> Any:
    """Return the value that `packed` took apart; the numbers are the same to the last bit."""
    ((kind, value),) = data.items()
    if kind == "text":
        return value
    if kind in ("tuple", "list"):
        items = [unpacked(item, arrays) for item in value]
        return tuple(items) if kind == "tuple" else items
    if kind == "dict":
        return {key: unpacked(item, arrays) for key, item in value.items()}
    numbers = np.array(arrays[value])
    return numbers if kind == "array" else numbers[()] if kind == "scalar" else numbers[()].item()
