"""Tasks that tests share, so that each is compiled once."""

from functools import cache

import numpy as np

import holdfast as hf


@cache
def carry() -> hf.gym.CarryTask:
    """Return the task of carrying as it is by default."""
    return hf.gym.CarryTask()


@cache
def short_carry() -> hf.gym.CarryTask:
    """Return one whose episodes are short, and often end as the box is pushed out of the fingers."""
    return hf.gym.CarryTask(duration=0.3, settle=0.1, push=[0, 0, 0, 40, 40, 40], steps_per_action=5)


@cache
def hand_over() -> hf.gym.HandOverTask:
    """Return the task of handing over as it is by default."""
    return hf.gym.HandOverTask()


@cache
def careless_hand_over() -> hf.gym.HandOverTask:
    """Return one whose receiver grips wherever it is: random actions lead through all phases, and break the box."""
    capture = {"capture": 1.0, "capture_angle": 3.0, "capture_speed": 5.0, "capture_rate": 20.0}
    return hf.gym.HandOverTask(
        **capture, duration=0.5, crushing_internal=50.0, steps_per_action=5, retreat=np.full(7, 0.02)
    )


@cache
def place() -> hf.gym.PlaceOnTableTask:
    """Return the task of placing an object as it is by default."""
    return hf.gym.PlaceOnTableTask()


def parts(
    task: hf.gym.CarryTask | hf.gym.HandOverTask | hf.gym.PlaceOnTableTask, observation: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the parts of an observation by name."""
    ends = np.cumsum([len(bound) for bound in task.observed.values()])
    return dict(zip(task.observed, np.split(observation, ends[:-1]), strict=True))
