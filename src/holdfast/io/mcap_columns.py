"""The numbers in ROS 2 messages of an MCAP file as columns on one clock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import MissingExtra, ResultError
from holdfast.io.files import one_line
from holdfast.spatial.scalar import Array

BRIDGED_STEPS = 5.0  # median intervals of a topic, beyond which nothing is interpolated
OF_JOINT_STATE = {"position": "q", "velocity": "qd", "effort": "tau"}
NANOSECONDS = 1_000_000_000


def mcap_columns(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """Return columns by name, (samples,), and units by name, from an MCAP file of ROS 2 messages.

    Every number of a message is a column, `/topic field.part`, and of a list `/topic field 0`, `/topic field 1`.
    Those of a JointState are `/topic position NAME` by the joints' names, and `q NAME`, `qd NAME`, `tau NAME`, unless
    several topics have the same joint. The column `t` has the stamps [s] from the first one on, those of messages'
    headers, or else those of the log. They are the stamps of the JointState topic with most messages, or of the topic
    with most. Other topics are interpolated to them linearly; NaN before their first message, behind their last one,
    and in gaps.

    Raises:
        ResultError: it is no MCAP file of ROS 2 messages, or has no numbers.
        MissingExtra: mcap-ros2-support is not installed.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as cause:
        raise MissingExtra("MCAP files need mcap-ros2-support; try pip install 'holdfast[ros]'") from cause
    stamps: dict[str, list[int]] = {}
    numbers: dict[str, dict[str, list[float]]] = {}
    jointed: set[str] = set()
    try:
        with path.open("rb") as file:
            for schema, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages():
                topic, is_joints = channel.topic, schema is not None and schema.name.endswith("/JointState")
                found = dict(_of_joints(decoded) if is_joints else _leaves(decoded, ""))
                if not found:
                    continue
                if is_joints:
                    jointed.add(topic)
                rows = numbers.setdefault(topic, {})
                done = len(stamps.setdefault(topic, []))
                stamps[topic].append(_stamp(decoded) or message.log_time)
                for name in rows.keys() | found.keys():
                    column = rows.setdefault(name, [])
                    column += [np.nan] * (done - len(column)) + [found.get(name, np.nan)]
    except (McapError, ValueError, EOFError, TypeError, KeyError, RuntimeError, OverflowError) as cause:
        raise ResultError(
            f"{path}: expected an MCAP file of ROS 2 messages: {one_line(str(cause) or type(cause).__name__, 200)}"
        ) from cause
    if not stamps:
        raise ResultError(f"{path}: expected ROS 2 messages with numbers, got none")
    return _on_one_clock(stamps, numbers, jointed)


def _on_one_clock(
    stamps: dict[str, list[int]], numbers: dict[str, dict[str, list[float]]], jointed: set[str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Return columns and units of the topics, on the clock of one of them."""
    clock = max(jointed or stamps, key=lambda topic: len(stamps[topic]))
    first = stamps[clock][0]
    t = np.array([stamp - first for stamp in stamps[clock]], dtype=float) / NANOSECONDS
    columns, units = {"t": t}, {"t": "s"}
    whose: dict[str, list[str]] = {}
    for topic, rows in numbers.items():
        own = np.array([stamp - first for stamp in stamps[topic]], dtype=float) / NANOSECONDS
        for name, values in rows.items():
            column = f"{topic} {name}"
            columns[column] = np.array(values) if topic == clock else _interpolated(t, own, np.array(values))
            kind, _, joint = name.partition(" ")
            if topic in jointed and kind in OF_JOINT_STATE:
                whose.setdefault(f"{OF_JOINT_STATE[kind]} {joint}", []).append(column)
    return columns | {name: columns[one[0]] for name, one in whose.items() if len(one) == 1}, units


def _interpolated(t: Array, own: Array, values: Array) -> Array:
    """Return the values at times t by lines between those at their own times; NaN outside of them and in gaps."""
    order = np.argsort(own, kind="stable")
    own, values = own[order], values[order]
    if len(own) < 2:
        return np.full(len(t), np.nan)
    after = np.clip(np.searchsorted(own, t), 1, len(own) - 1)
    steps = np.diff(own)
    longest = BRIDGED_STEPS * max(float(np.median(steps)), 1e-9)
    apart = (t < own[0]) | (t > own[-1]) | (steps[after - 1] > longest)
    return np.where(apart, np.nan, np.interp(t, own, values))


def _of_joints(message: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a JointState."""
    for kind in OF_JOINT_STATE:
        values = getattr(message, kind, ())
        if len(values) == len(message.name):
            yield from ((f"{kind} {name}", float(x)) for name, x in zip(message.name, values, strict=True))


def _leaves(message: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a message by their names, without those of its header."""
    if isinstance(message, bool | int | float):
        yield name, float(message)
    elif isinstance(message, Sequence | np.ndarray) and not isinstance(message, str | bytes):
        for k, one in enumerate(message):
            yield from _leaves(one, f"{name} {k}")
    elif slots := getattr(message, "__slots__", None):
        for key in slots:
            if key != "header":
                yield from _leaves(getattr(message, key), f"{name}.{key}" if name else key)


def _stamp(message: Any) -> int:
    """Return the stamp in a message's header [ns]; 0 without one."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else stamp.sec * NANOSECONDS + stamp.nanosec
