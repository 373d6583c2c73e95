"""Forests, and chains that are answered as forests, as machine code (`holdfast.compile`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from holdfast import outer
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.forest_forward import ForestForward, ForwardFunction, Kind, MechanismForward
from holdfast.compiled.forest_function import ForestFunction
from holdfast.compiled.forest_inverse import (
    ForestInverse,
    MechanismInverse,
    chain_inverse_terms,
    forest_inverse_terms,
)
from holdfast.compiled.forest_terms import ForestTerms, chain_terms, forest_terms
from holdfast.compiled.function import NotCompiledError
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import code_key
from holdfast.model.forest import Forest
from holdfast.names import called, unknown_attribute
from holdfast.questions.derivatives import Derivatives
from holdfast.questions.question import QUESTIONS

if TYPE_CHECKING:
    from holdfast.codegen.export import ExportedCode

F = TypeVar("F", bound=ForwardFunction)


class _Compiled(Generic[F]):
    """What machine code of forests and of chains that are answered as forests have in common."""

    def __init__(
        self,
        subject: Any,
        terms: Callable[[Any, Sequence[str]], ForestTerms],
        forward: Callable[[ForestFunction], F],
        parameters: Sequence[str],
        progress: bool | None,
    ) -> None:
        self.parameters, self.progress, self._subject = tuple(parameters), progress, subject
        key = f"{code_key(subject)}/{type(self).__name__}/{self.parameters}"
        self.function = ForestFunction(terms(subject, self.parameters), key, progress)
        self.inverse_key = f"{key}/inverse_dynamics"
        self.forward_dynamics = forward(self.function)

    def forward_dynamics_vjp(self, *given: Any, **further: Any) -> CompiledDerivatives:
        """Return gradients of forward dynamics: `forward_dynamics.vjp`."""
        return self.forward_dynamics.vjp(*given, **further)

    def forward_dynamics_jvp(self, *given: Any, **further: Any) -> CompiledDerivatives:
        """Return rates of forward dynamics: `forward_dynamics.jvp`."""
        return self.forward_dynamics.jvp(*given, **further)

    def forward_dynamics_jacobian(self, *given: Any, **further: Any) -> Derivatives:
        """Return the Jacobian of forward dynamics: `forward_dynamics.jacobian`."""
        return self.forward_dynamics.jacobian(*given, **further)

    def bind(self, kind: Kind | None = None, **names_and_inputs: Any) -> BoundFunction:
        """Return forward dynamics bound to fixed arrays: `forward_dynamics.bind`."""
        return self.forward_dynamics.bind(kind, **names_and_inputs)

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write forward dynamics, derivatives of it, and inverse dynamics as C or object files that run without Python.

        Args:
            folder: the folder to which the files are written.
            **options: the keyword arguments of `holdfast.codegen.export_c`.

        Raises:
            HoldfastError: `holdfast.codegen.export_c` raised it.
        """
        return outer.export_c(self, folder, **{"progress": self.progress, **options})

    def __getattr__(self, name: str) -> Any:
        """Raise an error that says that a question has no machine code here."""
        if name in QUESTIONS:
            raise NotCompiledError(
                f"compile: '{name}': expected forward_dynamics of a forest, or of a chain that is answered as a forest,"
                " which have no machine code but of it, its derivatives, and inverse_dynamics; try the function of the"
                " chain that runs as reference"
            )
        raise unknown_attribute(self, name)

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations for one system."""
        return self.function.calls.kernel.operation_count

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the object: its machine code is loaded from the cache or compiled again."""
        return type(self), (self._subject, self.parameters, self.progress)

    def __repr__(self) -> str:
        """Return what it is about."""
        return f"<{type(self).__name__} of {self._subject!r}>"


@called
class CompiledForest(_Compiled[ForestForward]):
    """The dynamics of one forest as machine code; made by `holdfast.compile`.

    Attributes:
        forest: the forest, all numbers of which are constants of the code.
        forward_dynamics: a `ForestForward`, with its derivatives.
        inverse_dynamics: a `ForestInverse`.
        parameters: ("link_wrench",) if external wrenches on the bodies are an input, else ().
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    def __init__(self, forest: Forest, parameters: Sequence[str] = (), progress: bool | None = None) -> None:
        self.forest = forest
        super().__init__(forest, forest_terms, ForestForward, parameters, progress)
        self.inverse_dynamics = ForestInverse(forest_inverse_terms(forest, self.parameters), self.inverse_key, progress)


@called
class CompiledMechanism(_Compiled[MechanismForward]):
    """The dynamics of one chain with branches, loops, couplings or several objects as machine code.

    It is made by `holdfast.compile`, and all numbers of the chain are constants of the code.

    Attributes:
        chain: the chain.
        forward_dynamics: a `MechanismForward`, with its derivatives.
        inverse_dynamics: a `MechanismInverse`.
        parameters: ("link_wrench",) if external wrenches on the links are inputs, else ().
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    def __init__(self, chain: ClosedChain, parameters: Sequence[str] = (), progress: bool | None = None) -> None:
        self.chain = chain
        super().__init__(chain, chain_terms, MechanismForward, parameters, progress)
        self.inverse_dynamics = MechanismInverse(
            chain_inverse_terms(chain, self.parameters), self.inverse_key, progress
        )
