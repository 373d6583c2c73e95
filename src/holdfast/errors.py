"""The errors of holdfast: each message says what was expected, what came, and what to try."""

from __future__ import annotations

import math
import warnings


class HoldfastError(Exception):
    """Root of every error this library raises on purpose."""


class ModelError(HoldfastError, ValueError):
    """A part of the model (joint, link, arm, object, grasp) cannot exist."""


class StateError(HoldfastError, ValueError):
    """A state or an input has the wrong shape, is not finite, or breaks the grasps."""


class StepTooLongError(StateError):
    """A fixed time step is too long for a joint that settles quickly: the result would be an artefact of the scheme.

    Attributes:
        joint: the joint that settles too fast, as 'arm/joint'.
        step: a step that works [s]; NaN if none was found.
    """

    def __init__(self, message: str, joint: str = "", step: float = math.nan) -> None:
        """Store the message and the data needed to retry."""
        super().__init__(message)
        self.joint, self.step = joint, step

    def __reduce__(self) -> tuple[type[StepTooLongError], tuple[str, str, float]]:
        """Return the constructor and its arguments, for pickling."""
        return type(self), (str(self), self.joint, self.step)


class CallError(HoldfastError, TypeError):
    """The arguments of a call do not fit: a name is unknown, or one is missing, given twice or too many."""


class UnknownName(HoldfastError, AttributeError):
    """A package or an object has no such name; the message suggests the nearest one that it has."""


class ClosureError(HoldfastError):
    """No joint positions within the limits close the chains on the object."""


class SingularChainError(HoldfastError, ArithmeticError):
    """The rank of the grasp constraint drops at this configuration."""


class ContactError(HoldfastError, ArithmeticError):
    """The laws of contact between object and world have no solution here, or none was found.

    Attributes:
        status: name of the `ContactStatus`, "JAMMED" or "UNRESOLVED".
    """

    def __init__(self, message: str, status: str = "UNRESOLVED") -> None:
        """Store the message and the status."""
        super().__init__(message)
        self.status = status

    def __reduce__(self) -> tuple[type[ContactError], tuple[str, str]]:
        """Return the constructor and its arguments, for pickling."""
        return type(self), (str(self), self.status)


class MethodNotApplicable(HoldfastError):
    """The chosen algorithm does not cover this chain; the message names one that does."""


class SceneError(HoldfastError, ValueError):
    """A scene, case or robot file is unreadable or says something impossible."""


class ResultError(HoldfastError):
    """A result folder cannot be written or read."""


class FrozenError(HoldfastError, AttributeError, TypeError):
    """An immutable object was to be changed; the message names the alternative."""


class MissingExtra(HoldfastError, ImportError):
    """An optional package is needed; the message names the extra that brings it."""


class DeprecatedNameWarning(FutureWarning):
    """A name that the next minor version drops; the message names its replacement."""


def warn_renamed(old: str, new: str, until: str) -> None:
    """Warn the caller of a function, or of a module's `__getattr__`, that it was reached by an old name.

    Args:
        old: the name that was used, such as `hf.old` or `simulate(old=)`.
        new: the name to use.
        until: the version without the old name.
    """
    message = f"{old} is now {new}; the old name goes with version {until}"
    warnings.warn(message, DeprecatedNameWarning, stacklevel=3)


class ModelWarning(UserWarning):
    """Parts of a robot's file were ignored or changed; each line names an element and what was done with it."""
