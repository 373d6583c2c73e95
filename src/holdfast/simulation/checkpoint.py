"""Checkpoints, from which a run continues with exactly the samples of an uninterrupted run.

`simulate(..., on_checkpoint=keep)` passes a `Checkpoint` to `keep` after every sample (after `on_sample` has received
that sample). `simulate(..., start=checkpoint)`, called with the same chain, controller, duration, step and options as
the first time, returns the samples after that one. The arrays of the first part, followed by those of the second, are
identical to those of an uninterrupted run. The argument `state` of `simulate` is not used in this case.

On disk a checkpoint consists of arrays by name, for an .npz file, and of plain data, for a JSON file. Numbers keep all
their digits:

    arrays, data = checkpoint.to_data()
    checkpoint = Checkpoint.from_data(arrays, data)

Occurrences (grasps that close, open or slip, and limits that are passed) are stored twice. Each sample carries its own
`occurrences` beside its arrays, which `stacked` joins; and a checkpoint carries all of them since the start, so that
the log is complete even if the process was killed.

A checkpoint does not contain the chain, which the caller builds again from its scene. It contains the grasps, because
arms attach and release during a run. The memory of a controller may consist of None, booleans, integers, floats,
strings, NumPy arrays of these, and tuples, lists and dicts (with string keys) of all of them. Anything else is refused,
with its name, when the checkpoint is written, not when it is made. A run that is not saved may therefore use any
memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Self

import msgspec
import numpy as np

from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.dynamics.contact.sliding_hands import Hand
from holdfast.errors import ResultError
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.grasp_rows import row_name
from holdfast.simulation.adaptive import Proposal
from holdfast.simulation.balance import Sums
from holdfast.simulation.events import Occurrence
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.resolution import NOTHING_NOTICED, Resolution
from holdfast.simulation.zero_order_hold import HeldTorques
from holdfast.spatial.frozen import making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State, exact_state, parts_of

TRACKER = "ledger"  # its name in result folders


@dataclass(frozen=True, eq=False)
class Origin:
    """The data from which an accepted instant was evaluated, and from which it can be evaluated again.

    Attributes:
        t: time [s].
        state: positions and velocities.
        memory: the memory passed to the controller, not the memory that it returned.
    """

    t: float
    state: State
    memory: Any


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A run at one of its samples.

    Attributes:
        now: time and state of the sample, and the memory passed to the controller.
        grasps: the grasps that are closed.
        generic_rank: generic rank of the constraint with these grasps.
        tracker: the margins so far.
        sums: work and impulses since the start.
        previous: as `now` for the previous accepted instant, needed to refine a minimum of a margin that lies before
            `now`; None if `now` begins a smooth stretch.
        tail_time: the last time before `now` at which the margins were evaluated [s].
        tail: the margins at that time; empty without `previous`.
        stop: number of stop times (see `Stops`) that have been passed.
        event: number of events that have happened.
        implicit: whether steps are linearly implicit, see `Segment`.
        occurrences: everything that has happened so far.
        proposal: state of the step-size control; None for steps of fixed length.
        held: state of the zero-order hold of a sampled controller; None if the controller is evaluated at every stage.
        resolution: whether steps of fixed length have followed the motion.
        contacts: modes of the contacts from which `now` was evaluated, with hands that slide; None without contacts.
        least_gap: (k,) as in `Segment`.
    """

    now: Origin
    grasps: Mapping[Any, Grasp]
    generic_rank: int
    tracker: ViolationTracker = field(repr=False)
    sums: Sums = field(default_factory=making(Sums, np.zeros(4), 0.0, np.zeros(6)))
    previous: Origin | None = None
    tail_time: float = 0.0
    tail: Array = field(default_factory=making(np.zeros, 0))
    stop: int = 0
    event: int = 0
    implicit: bool = False
    occurrences: tuple[Occurrence, ...] = ()
    proposal: Proposal | None = None
    held: HeldTorques | None = None
    resolution: Resolution = NOTHING_NOTICED
    contacts: ContactModes | None = None
    least_gap: Array | None = None

    def to_data(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Return arrays by name, and plain data that can be written as JSON.

        Raises:
            ResultError: the memory of the controller contains something that cannot be written; the message names it.
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
            "grasps": [_grasp_data(key, grasp, arrays) for key, grasp in self.grasps.items()],
            "now": _origin_data("now", self.now, arrays),
            "resolution": list(self.resolution),
            "held": None if self.held is None else packed(vars(self.held), "held", arrays),
            "previous": None if self.previous is None else _origin_data("previous", self.previous, arrays),
        }
        if self.contacts is not None:
            arrays |= {"contacts.mode": self.contacts.mode, "contacts.slip": self.contacts.slip}
            data |= {name: sorted(getattr(self.contacts, name)) for name in ("begins", "straight")}
            arrays |= {} if self.least_gap is None else {"contacts.least_gap": self.least_gap}
            data["hands"] = [_grasp_data(hand.arm, hand.grasp, arrays) for hand in self.contacts.hands]
        return arrays, data

    @classmethod
    def from_data(cls, arrays: Mapping[str, Array], data: Mapping[str, Any]) -> Self:
        """Return the checkpoint that `to_data` has written.

        Raises:
            ResultError: an entry is missing or malformed.
        """
        try:
            previous, contacts = data["previous"], None
            if "contacts.mode" in arrays:
                hands = tuple(Hand(*_grasp(given, arrays)) for given in data["hands"])
                contacts = ContactModes(
                    np.array(arrays["contacts.mode"]),
                    np.array(arrays["contacts.slip"]),
                    hands,
                    *(frozenset(data.get(name, ())) for name in ("begins", "straight")),
                )
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
                resolution=msgspec.convert(data.get("resolution", []), Resolution),
                held=None if data.get("held") is None else HeldTorques(**unpacked(data["held"], arrays)),
                tracker=ViolationTracker(*(np.array(arrays[f"{TRACKER}.{f.name}"]) for f in fields(ViolationTracker))),
                contacts=contacts,
                least_gap=np.array(arrays["contacts.least_gap"]) if "contacts.least_gap" in arrays else None,
            )
        except (KeyError, TypeError, ValueError, AttributeError, msgspec.ValidationError) as cause:
            raise ResultError(f"checkpoint: cannot be read: {cause!r}; try starting the run anew") from cause


def _origin_data(name: str, origin: Origin, arrays: dict[str, Array]) -> Any:
    arrays |= {f"{name}.{part}": array for part, array in parts_of(origin.state).items()}
    arrays[f"{name}.t"] = np.array(origin.t)
    return packed(origin.memory, f"{name}.memory", arrays)


def _origin(name: str, memory: Any, arrays: Mapping[str, Array]) -> Origin:
    saved = {f.name: np.array(arrays[at]) for f in fields(State) if (at := f"{name}.{f.name}") in arrays}
    return Origin(float(arrays[f"{name}.t"]), exact_state(saved), unpacked(memory, arrays))


_OF_GRASP = ("motion", "stiffness", "damping")  # arrays that only some kinds of grasp have


def _grasp_data(key: Any, grasp: Grasp, arrays: dict[str, Array]) -> dict[str, Any]:
    name = row_name(key)
    arrays |= {f"grasps.{name}.R": grasp.frame.R, f"grasps.{name}.p": grasp.frame.p}
    own = {part: getattr(grasp, part) for part in _OF_GRASP}
    arrays |= {f"grasps.{name}.{part}": x for part, x in own.items() if x is not None}
    data = {"arm": key if isinstance(key, str) else list(key), "kind": grasp.kind, "pitch": grasp.pitch, "of": grasp.of}
    for part, of in (("contact", grasp.contact), ("wrench_limits", grasp.wrench_limits)):
        found = None if of is None else {f.name: getattr(of, f.name) for f in fields(of)}
        data[part] = packed(found, f"grasps.{name}.{part}", arrays)
    return data


def _grasp(given: Mapping[str, Any], arrays: Mapping[str, Array]) -> tuple[Any, Grasp]:
    key = given["arm"] if isinstance(given["arm"], str) else tuple(given["arm"])
    name = row_name(key)
    frame = Pose(np.array(arrays[f"grasps.{name}.R"]), np.array(arrays[f"grasps.{name}.p"]))
    contact, limits = (unpacked(given[part], arrays) for part in ("contact", "wrench_limits"))
    of_kind: dict[str, Any] = {part: arrays.get(f"grasps.{name}.{part}") for part in _OF_GRASP}
    return key, Grasp(
        given["kind"],
        frame,
        None if contact is None else Friction(**contact),
        None if limits is None else WrenchLimits(**limits),
        given.get("pitch"),
        of=given.get("of"),
        **of_kind,
    )


_NUMBERS = {bool: "bool", int: "int", float: "float"}


def packed(value: Any, name: str, arrays: dict[str, Array]) -> Any:
    """Return the structure of a value as plain data, and add its numbers to the arrays.

    Args:
        value: None, a boolean, a number, a string, an array, or a tuple, list or dict of these.
        name: name of the value in messages; also the beginning of the names of its arrays.
        arrays: the dictionary to which the numbers are added.

    Raises:
        ResultError: a part of the value cannot be written; the message names it.
    """
    kind = type(value)
    if value is None or kind is str:
        return {"text": value}
    if kind in (tuple, list):
        return {kind.__name__: [packed(item, f"{name}[{i}]", arrays) for i, item in enumerate(value)]}
    if kind is dict and all(type(key) is str for key in value):
        return {"dict": {key: packed(item, f"{name}.{key}", arrays) for key, item in value.items()}}
    place = f"{name}:{len(arrays)}"  # the number makes the name unique, whatever characters the keys contain
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
    """Return the value from the output of `packed`; its numbers are identical to the last bit."""
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
