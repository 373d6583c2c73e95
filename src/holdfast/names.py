"""Errors that suggest the right name for a wrong one or a wrong call, and the lazy loading of public names."""

from __future__ import annotations

import difflib
import functools
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import lazy_loader

from holdfast.errors import CallError, StateError, UnknownName

PLAIN = ("world.py", "plot.py", "errors.py")  # public modules that are one file
MOST_LISTED = 40  # names in a message that lists what is known
SURE = 0.8  # similarity of names from which on a suggestion needs no list beside it
RENAMED = {
    "squeeze": "internal_force",
    "squeeze_span": "internal_force_span",
    "internal": "internal_force",
    "undriven": "passive",
    **dict.fromkeys(("dt", "timestep", "time_step"), "step"),
    "rotation": "turn",
    "margin": "least_margin",
    **{f"{robot.upper()}_HOME": f'HOME["{robot}"]' for robot in ("panda", "iiwa14", "ur5e", "gen3")},
}
Class = TypeVar("Class", bound=type)
Called = TypeVar("Called", bound=Callable[..., Any])


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ' Did you mean ...?' with the closest known name in any case, or the known names, or both if unsure."""
    known = list(known)
    if (renamed := RENAMED.get(str(name), "")).partition("[")[0] in known:
        return f" Did you mean '{renamed}'?"
    cases = {each.lower(): each for each in reversed(known)}
    for cutoff in (SURE, 0.6 if len(str(name)) > 4 else 0.5):
        near = difflib.get_close_matches(str(name), known, n=1, cutoff=cutoff)
        any_case = difflib.get_close_matches(str(name).lower(), cases, n=1, cutoff=max(cutoff, 0.6))
        near = near or [cases[each] for each in any_case]
        if near:
            break
    hint = f" Did you mean '{near[0]}'?" if near else ""
    more = f" and {len(known) - MOST_LISTED} more" if len(known) > MOST_LISTED else ""
    return hint if near and cutoff == SURE else f"{hint} Known: {', '.join(known[:MOST_LISTED]) or 'none'}{more}."


def unknown_name(package: str, name: str, known: Iterable[str]) -> UnknownName:
    """Return the error for a name that a package does not have, with its place in holdfast, or a suggestion."""
    name = " ".join(name.split())[:80]
    if name.startswith("_"):  # programs ask for these, such as pytest for each namespace that a test imports
        return UnknownName(f"{package} has no '{name}'")
    if (place := _place_of(name)) not in (None, package):
        return UnknownName(f"{package} has no '{name}'; try {place}.{name}")
    return UnknownName(f"{package} has no '{name}'.{did_you_mean(name, known)}")


def _place_of(name: str) -> str | None:
    """Return the module in which users find a public name, read from the sources because `hasattr` asks, too."""
    states = re.compile(rf"^(class {re.escape(name)}\b|from \S+ import (\w+ as )?{re.escape(name)}$)", re.MULTILINE)
    top = Path(__file__).parent
    for file in (top / "__init__.pyi", *(top / each for each in PLAIN), *sorted(top.glob("*/__init__.pyi"))):
        if states.search(file.read_text(encoding="utf-8")):
            place = file.parent if file.stem == "__init__" else file.with_suffix("")
            return ".".join(("holdfast", *place.relative_to(top).parts))
    return None


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose public names its stub lists; see `lazy_loader`.

    A function is wrapped by `called` in the module that defines it, too, so that both have the same object.

    Args:
        package: name of the package.
        file: its `__init__.py`.
    """
    load, _, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name not in names:
            raise unknown_name(package, name, names)
        found = load(name)
        if inspect.isfunction(found):
            found = called(found)
            for module in (found.__module__, package):
                vars(sys.modules[module])[name] = found
        return found

    return get, names.copy, names


def named(cls: Class) -> Class:
    """Return a class after making the error for an attribute that it does not have suggest the nearest one."""
    if not any("__getattr__" in vars(base) for base in cls.__mro__):
        cls.__getattr__ = _unknown_attribute  # type: ignore[attr-defined]
    return cls


def _unknown_attribute(of: Any, name: str) -> NoReturn:
    if hasattr(type(of), name):
        object.__getattribute__(of, name)  # a property's own error
    raise unknown_attribute(of, name)


def unknown_attribute(of: Any, name: str) -> UnknownName:
    """Return the error for an attribute that an object does not have, with a suggestion unless the name is private."""
    known = [] if name.startswith("_") else [each for each in dir(of) if not each.startswith("_")]
    hint = did_you_mean(name, known) if known else ""
    return UnknownName(f"'{type(of).__name__}' object has no attribute '{name}'{'.' * bool(hint)}{hint}")


def called(of: Called) -> Called:
    """Return a function, or a class with its constructors and public methods, whose wrong calls raise a `CallError`.

    A call is wrong if its arguments do not fit the signature; other calls are passed on unchanged. So are all of
    constructors that check nothing (`Pose.unchecked`), which algorithms call. Attributes that such an object does not
    have raise an `UnknownName`.

    Raises:
        CallError: a name is unknown, an argument is missing or given twice, or there are too many.
        StateError: linear algebra fails on the numbers, such as a singular value decomposition of ones that overflow.
    """
    if isinstance(of, type):
        named(of)
        for name, method in [*vars(of).items()]:
            of_class = isinstance(method, staticmethod | classmethod)
            function = method.__func__ if of_class else method
            if not inspect.isfunction(function) or name.startswith("unchecked"):
                continue
            if name in ("__init__", "__call__"):
                setattr(of, name, _called(function, of.__name__))
            elif not name.startswith("_"):
                made = _called(function, f"{of.__name__}.{name}" if of_class else name)
                setattr(of, name, type(method)(made) if of_class else made)
        return of  # type: ignore[return-value]
    return _called(of, of.__name__)  # type: ignore[return-value]


def no_arguments(what: str, given: tuple[Any, ...]) -> None:
    """Refuse arguments of a call that takes none, because it reads fixed arrays.

    Raises:
        CallError: there are arguments.
    """
    if given:
        raise CallError(f"{what}: expected no arguments, got {len(given)}; try writing into its arrays before the call")


def _called(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*args: Any, **given: Any) -> Any:
        try:
            return function(*args, **given)
        except TypeError:
            if (wrong := wrong_call(inspect.signature(function), name, args, given)) is None:
                raise
        except ValueError as cause:
            if not is_numeric_failure(cause):
                raise
            raise numeric_failure(name) from cause
        raise wrong

    return call


def is_numeric_failure(error: BaseException) -> bool:
    """Return whether linear algebra of this package failed on its numbers, rather than that of a caller's function."""
    if type(error).__name__ != "LinAlgError":  # NumPy's, which is not imported here
        return False
    frame, modules = error.__traceback__, list[str]()
    while frame is not None:
        modules.append(frame.tb_frame.f_globals.get("__name__", ""))
        frame = frame.tb_next
    callers = [module for module in modules if module.partition(".")[0] not in ("numpy", "scipy")]
    return callers[-1].partition(".")[0] == "holdfast"


def numeric_failure(what: str) -> StateError:
    """Return the error for numbers with which linear algebra fails."""
    return StateError(
        f"{what}: expected numbers of comparable sizes, got an overflow of float64 or a matrix that rounding makes"
        " singular; check the sizes of lengths, masses, velocities and forces"
    )


def _takes(parameter: inspect.Parameter, value: Any) -> bool:
    """Return whether a parameter is annotated with the class of a value, if that is one of holdfast's."""
    of = type(value)
    ours = of.__module__.partition(".")[0] == "holdfast"
    return ours and of.__name__ in re.findall(r"\w+", str(parameter.annotation))


def wrong_call(
    signature: inspect.Signature, name: str, args: Sequence[Any], given: Mapping[str, Any]
) -> CallError | None:
    """Return the error for arguments that do not fit a signature; None if they do.

    Args:
        signature: the signature.
        name: name of the function, for the message.
        args: positional arguments.
        given: keyword arguments.
    """
    try:
        signature.bind(*args, **given)
    except TypeError as error:
        said = str(error)
    else:
        return None
    kinds, parameters = inspect.Parameter, list(signature.parameters.values())
    own = sum(p.name in ("self", "cls") for p in parameters[:1])
    parameters, args = parameters[own:], args[own:]
    by_place = [p.name for p in parameters if p.kind in (kinds.POSITIONAL_ONLY, kinds.POSITIONAL_OR_KEYWORD)]
    known = [p.name for p in parameters if p.kind in (kinds.POSITIONAL_OR_KEYWORD, kinds.KEYWORD_ONLY)]
    anything = any(p.kind == kinds.VAR_KEYWORD for p in parameters)
    have = {*by_place[: len(args)], *given}
    missing = [p.name for p in parameters if p.default is p.empty and p.name in known and p.name not in have]
    unknown = [key for key in given if key not in known]
    if anything:  # the function refuses unknown names itself, but one that is missing may be misspelt
        unknown = [key for key in unknown if difflib.get_close_matches(key, missing, cutoff=0.8)]
    if unknown:
        taking = [p.name for p in parameters if p.name not in have and _takes(p, given[unknown[0]])]
        hint = f" Did you mean '{taking[0]}'?" if len(taking) == 1 else did_you_mean(unknown[0], known)
        return CallError(f"{name}: no argument '{unknown[0]}'.{hint}")
    if len(args) > len(by_place):
        order = f" in the order {', '.join(by_place)}" if by_place else ""
        return CallError(
            f"{name}: expected at most {len(by_place)} arguments without names{order}, got {len(args)}; try names for"
            " the others"
        )
    if twice := [key for key in by_place[: len(args)] if key in given]:
        return CallError(f"{name}: expected {twice[0]} once, got it by place and by name")
    if missing:
        taken = ", ".join(f"{key}: {type(x).__name__}" for key, x in zip(by_place, args, strict=False))
        by_order = f" (given by order: {taken})" * bool(taken)
        return CallError(f"{name}: expected {', '.join(missing)} too, got no value{by_order}; try {missing[0]}=...")
    return CallError(f"{name}: {said}")
