"""Answers to problem cases as tables to read."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.table import Table

from holdfast.cli.answer import Answer
from holdfast.cli.console import stdout
from holdfast.dynamics.result import Status


def print_answers(answers: list[Answer]) -> None:
    """Print a line per answer, why some were refused, and the numbers of a single one."""
    console = stdout()
    table = Table("case", "method", "status", "rank", "mobility", "error")
    for answer in answers:
        table.add_row(answer.case.name, answer.method, *_line(answer))
    console.print(table)
    refused = [answer for answer in answers if answer.reason is not None]
    if len({answer.case.name for answer in answers}) == 1:
        for answer in refused:
            console.print(f"{answer.method}: refused: {answer.reason}", soft_wrap=True)
    elif refused:
        kinds = Counter(_kind(answer) for answer in refused)
        listed = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        console.print(f"refused: {listed}; --case NAME or --format json says why")
    if len(answers) == 1:
        print_numbers(console, answers[0])


def _kind(answer: Answer) -> str:
    return (answer.reason or "").partition(":")[0]


def _line(answer: Answer) -> tuple[str, str, str, str]:
    """Return status, rank, mobility and error of an answer."""
    if answer.result is None:
        return f"refused: {_kind(answer)}", "", "", ""
    r = answer.result
    status = "ok" if r.status is Status.OK else "ok, f not unique"
    error = "" if answer.error is None else f"{answer.error:.1e}"
    return status, f"{r.rank} of {r.chain.constraint_row_count}", str(r.mobility), error


def print_numbers(console: Console, answer: Answer) -> None:
    """Print joint accelerations, grasp forces and the object's acceleration of one answer."""
    r = answer.result
    if r is None:
        return
    joints = Table("arm", "joint", "acceleration", "unit", title="joint accelerations, base to tip")
    for name, arm in r.chain.arms.items():
        for k, (joint, qdd) in enumerate(zip(arm.joints, r[name].qdd, strict=True)):
            unit = "rad/s^2" if joint.kind == "revolute" else "m/s^2"
            joints.add_row(name if k == 0 else "", joint.name or f"{joint.kind} {k + 1}", f"{qdd:+.6g}", unit)
    console.print(joints)

    title = "what each arm exerts on the object, about the contact point, world axes"
    forces = Table("arm", "grasp", "force x, y, z [N]", "moment x, y, z [N m]", title=title)
    for name, grasp in r.chain.grasps.items():
        moment, force = r[name].grasp_wrench[:3], r[name].grasp_wrench[3:]
        forces.add_row(name, grasp.kind, _triple(force), _triple(moment))
    console.print(forces)
    if r.status is not Status.OK:
        console.print(r.status.value, soft_wrap=True)
    angular, linear = r.object_acceleration[:3], r.object_acceleration[3:]
    console.print(f"object: angular acceleration {_triple(angular)} rad/s^2, of C {_triple(linear)} m/s^2")


def _triple(vector) -> str:
    return ", ".join(f"{x:+.6g}" for x in vector)
