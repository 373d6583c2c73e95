"""URDF files with rotors, springs, dampers and gravity switches in every spelling, and what they say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

JOINTS = ("shoulder", "elbow", "wrist")
SIMPLE = "<type>transmission_interface/SimpleTransmission</type>"
ROS2 = '<ros2_control name="system" type="system"><hardware><plugin>any/System</plugin></hardware>{}</ros2_control>'


@dataclass
class ExtendedFile:
    """A URDF file and the truth about it.

    Attributes:
        name: what is special about it.
        text: the file.
        truth: what each joint has, by joint and quantity; zero otherwise.
        refused: words of the refusal, "" if it is to be read.
    """

    name: str
    text: str
    truth: dict[str, dict[str, float]] = field(default_factory=dict)
    refused: str = ""


def robot(before: str = "", after: str = "", dynamics: str = "", hand: str = "", finger: str = "continuous") -> str:
    """Return an arm of three joints with a finger and a frame on its hand; `before` and `after` stand around it."""
    inertial = (
        '<inertial><mass value="2"/><inertia ixx="0.03" iyy="0.03" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(
        f'<link name="{name}">{inertial}{hand if name == "hand" else ""}</link>'
        for name in ("base", "upper", "lower", "hand", "thumb")
    )
    pairs = zip(
        (*JOINTS, "pinch"), ("base", "upper", "lower", "hand"), ("upper", "lower", "hand", "thumb"), strict=True
    )
    joints = "".join(
        f'<joint name="{name}" type="{finger if name == "pinch" else "continuous"}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>'
        f'<limit effort="9" velocity="9"/>{dynamics if name == "elbow" else ""}</joint>'
        for name, parent, child in pairs
    )
    frame = '<link name="tip"/><joint name="at" type="fixed"><parent link="hand"/><child link="tip"/></joint>'
    return f'<robot name="extended">{before}{links}{joints}{frame}{after}</robot>'


def rotors(joint: str, inertia: float, ratio: float) -> dict[str, str]:
    """Return one rotor behind a gear in every spelling, by the name of the spelling."""
    n, J = f"{ratio!r}", f"{inertia!r}"
    ros = '<transmission name="t"><joint name="{0}">{1}</joint><actuator name="m">{2}</actuator>{3}</transmission>'
    drake = f'<drake:rotor_inertia value="{J}"/><drake:gear_ratio value="{n}"/>'
    reduction = f"<mechanicalReduction>{n}</mechanicalReduction>"
    rotor2, gear2 = f"<rotor_inertia>{J}</rotor_inertia>", f"<mechanical_reduction>{n}</mechanical_reduction>"
    params = f'<param name="rotor_inertia">{J}</param>', f'<param name="gear_ratio">{n}</param>'
    simple = "<plugin>transmission_interface/SimpleTransmission</plugin>"
    in_ros2 = (
        f'<transmission name="t">{simple}<actuator name="m" role="actuator1">{{}}</actuator><joint name="{joint}">'
    )
    in_ros2 = f"{in_ros2}{{}}<offset>0.1</offset></joint></transmission>"
    return {
        "drake": ros.format(joint, "", drake, SIMPLE),
        "motorInertia": ros.format(joint, "", f"{reduction}<motorInertia>{J}</motorInertia>", SIMPLE),
        "rotorInertia, turned back": ros.format(
            joint, "", f"<mechanicalReduction>-{n}</mechanicalReduction><rotorInertia>{J}</rotorInertia>", SIMPLE
        ),
        "gear ratio at the joint": ros.format(joint, reduction, f"<motor_inertia>{J}</motor_inertia>", SIMPLE),
        "both reductions, one of 1": ros.format(
            joint, "<mechanicalReduction>1.0</mechanicalReduction>", f"{reduction}{rotor2}", SIMPLE
        ),
        "of the transmission": ros.format(joint, "", "", f"{reduction}<motor_inertia>{J}</motor_inertia>"),
        "attributes": ros.format(joint, "", "", "").replace('"m"', f'"m" mechanicalReduction="{n}" motorInertia="{J}"'),
        "ROS and Drake": ros.format(joint, "", f"{reduction}{drake}", SIMPLE),
        "ros2_control": ROS2.format(f'<joint name="{joint}"/>' + in_ros2.format(rotor2, gear2)),
        "ros2_control, both in the actuator": ROS2.format(in_ros2.format(rotor2 + gear2, "")),
        "parameters of a joint": ROS2.format(
            f'<joint name="{joint}"><command_interface name="effort"/>{"".join(params)}</joint>'
        ),
        "parameter and transmission": ROS2.format(
            f'<joint name="{joint}">{params[0]}</joint>' + in_ros2.format("", gear2)
        ),
        "parameters of an actuator": ROS2.format(in_ros2.format("".join(params), "")),
        "at the joint": f'<gazebo reference="{joint}"><gearRatio>{n}</gearRatio>{rotor2}</gazebo>',
        "said twice": ros.format(joint, "", drake, SIMPLE) + ROS2.format(in_ros2.format(rotor2, gear2)),
    }


def springs(joint: str, k: float, rest: float, damping: float) -> dict[str, str]:
    """Return a spring and a damper in every spelling that stands outside of the joint."""
    spring = f"<spring_stiffness>{k}</spring_stiffness><spring_reference>{rest}</spring_reference>"
    axis = f"<axis><xyz>0 1 0</xyz><dynamics>{spring}<damping>{damping}</damping></dynamics></axis>"
    blobs = f"<springStiffness>{k}</springStiffness><springReference>{rest}</springReference>"
    damper = f"<axis><dynamics><damping>{damping}</damping></dynamics></axis>"
    settings = "<implicitSpringDamper>1</implicitSpringDamper><provideFeedback>true</provideFeedback>"
    engine = (
        "<physics><ode><implicit_spring_damper>1</implicit_spring_damper><limit><cfm>0</cfm></limit></ode></physics>"
    )
    of = f'<gazebo reference="{joint}">{{}}</gazebo>'
    return {
        "sdf axis": of.format(axis),
        "springStiffness": of.format(settings + blobs + damper),
        "in several elements": "".join(map(of.format, (f"<springStiffness>{k}</springStiffness>", engine, damper)))
        + of.format(f"<springReference>{rest}</springReference>"),
        "by value": of.format(f'<springStiffness value="{k}"/><springReference value="{rest}"/>{damper}'),
        "in the engine": of.format(
            f"{engine[:-10]}</physics><physics><ode>{spring}<damping>{damping}</damping></ode></physics>"
        ),
    }


def gravity_switches() -> Iterator[ExtendedFile]:
    """Yield switches of gravity: off on a link that moves is refused, anything else is read."""
    for words, off in (
        ("<turnGravityOff>true</turnGravityOff>", True),
        ("<turnGravityOff>1</turnGravityOff>", True),
        ('<turnGravityOff value="true"/>', True),
        ("<gravity>false</gravity>", True),
        ("<gravity> 0 </gravity>", True),
        ("<turnGravityOff>false</turnGravityOff>", False),
        ("<gravity>1</gravity>", False),
    ):
        for link, counts in (("hand", True), ("thumb", True), ("base", False), ("tip", False)):
            text = robot(after=f'<gazebo reference="{link}">{words}</gazebo>')
            refused = f"gravity off for link '{link}'" if off and counts else ""
            yield ExtendedFile(f"gravity: {words} of {link}", text, refused=refused)
        if "turn" not in words:
            refused = "gravity off for link 'hand'" if off else ""
            yield ExtendedFile(f"gravity: {words} in the link", robot(hand=words), refused=refused)


def files(seed: int = 0) -> list[ExtendedFile]:
    """Return the files."""
    rng, made = np.random.default_rng(seed), []

    def size(low: float, high: float) -> float:
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    for number, spelling in enumerate(rotors("", 1, 1)):
        joint, inertia, ratio = JOINTS[number % 3], size(1e-6, 1e-3), size(2, 200)
        said, truth = rotors(joint, inertia, ratio)[spelling], {joint: {"armature": inertia * ratio**2}}
        made.append(ExtendedFile(f"rotor: {spelling}", robot(**{("before", "after")[number % 2]: said}), truth))
    for number, spelling in enumerate(springs("", 1, 1, 1)):
        joint, k, rest, damping = JOINTS[number % 3], size(1, 100), -size(0.1, 1), size(0.01, 1)
        said, truth = springs(joint, k, rest, damping)[spelling], {"stiffness": k, "rest": rest, "damping": damping}
        made.append(
            ExtendedFile(f"spring: {spelling}", robot(**{("after", "before")[number % 2]: said}), {joint: truth})
        )
    k, rest, damping, friction = size(1, 100), size(0.1, 1), size(0.01, 1), size(0.1, 1)
    own = f'<dynamics damping="{damping}" friction="{friction}" spring_stiffness="{k}" spring_reference="{rest}"/>'
    truth = {"elbow": {"damping": damping, "friction": friction, "stiffness": k, "rest": rest}}
    made.append(ExtendedFile("spring: in the joint", robot(dynamics=own), truth))
    again = springs("elbow", k, rest, damping)["springStiffness"]
    made.append(ExtendedFile("spring: said twice", robot(dynamics=own, after=again), truth))
    rotor = "<rotor_inertia>2e-4</rotor_inertia><gear_ratio>50</gear_ratio>"
    for name, said in (("in the joint", rotor), ("of the joint's actuator", f'<actuator name="m">{rotor}</actuator>')):
        made.append(ExtendedFile(f"rotor: {name}", robot(dynamics=said), {"elbow": {"armature": 2e-4 * 50**2}}))
    zeros = '<dynamics damping="0" friction="0.0"/>'
    made.append(
        ExtendedFile("spring: zeros in the joint", robot(dynamics=zeros, before=again),
                     {"elbow": {"damping": damping, "stiffness": k, "rest": rest}})
    )  # fmt: skip
    for what, said in (
        ("rotor", rotors("pinch", 1e-4, 50.0)["drake"]),
        ("spring", springs("pinch", k, 0, 1)["sdf axis"]),
    ):
        made.append(ExtendedFile(f"{what}: of a locked finger", robot(after=said)))
    both = [rotors("wrist", J, 10.0)["drake"].replace('"m"', f'"{name}"') for J, name in ((1e-4, "m"), (3e-4, "other"))]
    made.append(ExtendedFile("rotor: two motors", robot(after="".join(both)), {"wrist": {"armature": 0.04}}))
    made.append(ExtendedFile("rotor: of a gear alone", robot(after=rotors("wrist", 0.0, 160.0)["motorInertia"])))
    made.append(
        ExtendedFile("rotor: direct", robot(after=rotors("wrist", 0.25, 1.0)["drake"]), {"wrist": {"armature": 0.25}})
    )
    return made + wrong(k) + list(gravity_switches())


def wrong(k: float) -> list[ExtendedFile]:
    """Return files that contradict themselves, or say what a joint of the model cannot have."""
    contradiction = springs("elbow", k, 0.1, 1)["by value"] + springs("elbow", k + 1, 0.1, 1)["by value"]
    once = rotors("elbow", 1e-4, 50.0)["motorInertia"]
    two_gears = once.replace('"elbow">', '"elbow"><mechanicalReduction>3</mechanicalReduction>')
    apart = once + rotors("elbow", 2e-4, 50.0)["ros2_control"].replace('"m"', '"another"')
    unnamed = once.replace(' name="m"', "")
    differential = once.replace("<actuator", '<joint name="wrist"/><actuator')
    return [
        ExtendedFile("spring: contradiction", robot(after=contradiction), refused="expected one stiffness"),
        ExtendedFile("spring: negative", robot(after=springs("elbow", -k, 0, 1)["by value"]), refused="expected >= 0"),
        ExtendedFile(
            "rotor: contradiction", robot(after=once + once.replace("0.0001", "0.0002")), refused="expected one rotor"
        ),
        ExtendedFile("rotor: two gears", robot(after=two_gears), refused="expected one gear ratio"),
        ExtendedFile(
            "rotor: other values elsewhere", robot(after=apart), refused="expected one rotor inertia at the joint"
        ),
        ExtendedFile(
            "rotor: two without names", robot(after=unnamed + once), refused="expected one rotor, or actuators"
        ),
        ExtendedFile("rotor: of two joints", robot(after=differential), refused="closes a loop"),
        ExtendedFile("rotor: no number", robot(after=once.replace("0.0001", "${J}")), refused="expected a number"),
        ExtendedFile("gravity: no switch", robot(hand="<gravity>off</gravity>"), refused="expected true or false"),
    ]
