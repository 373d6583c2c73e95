"""Derivatives of a compiled chain: products with the Jacobian of forward dynamics, and the Jacobian itself."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled import arrays, statuses
from holdfast.compiled.arrays import Addresses
from holdfast.compiled.derivative_schedule import FOUND, WITH, Product
from holdfast.compiled.externals import BASE_MOTION, LINKS
from holdfast.compiled.kernels import kernel
from holdfast.compiled.not_compiled import NotCompiledError
from holdfast.compiled.parameters import parameters_of, parse_parameters
from holdfast.compiled.result import INDETERMINATE, CompiledResult, ResultLayout
from holdfast.compiled.structure import Options, Structure
from holdfast.compiler.kernel import Bound
from holdfast.dynamics.closed.forward_derivatives import ARGUMENTS, RESULTS
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain

STATE_AND_TORQUES = ("q", "qd", "tau", "object_pose", "object_twist")
NOT_UNIQUE = ("grasp_wrench", "base_wrench")  # where forces are not


class Derivative:
    """A product with the Jacobian of forward dynamics.

    Attributes:
        result: forward dynamics there.
    """

    result: CompiledResult

    def __init__(self, result: CompiledResult, names: Sequence[str]) -> None:
        self.__dict__.update(result=result, _names=tuple(names))

    def __getattr__(self, name: str) -> Array:
        """Return one part of the product, by the name of an argument or a result."""
        if name.startswith("_") or name not in self._names:
            raise AttributeError(f"no derivative '{name}'.{checks.did_you_mean(name, self.__dict__.get('_names', ()))}")
        return self.result.array(f"{FOUND}{name}")

    def __getitem__(self, name: str) -> Array:
        """Return one part of the product, by name."""
        return getattr(self, name)


class CompiledProduct:
    """A product with the Jacobian of forward dynamics as machine code."""

    def __init__(self, compiled: CompiledChain, product: Product) -> None:
        """Compile, or find what is compiled already.

        Args:
            compiled: the chain whose forward dynamics it is of.
            product: which.
        """
        self._compiled, self.product, chain = compiled, product, compiled.chain
        structure = Structure(chain, options_of(compiled.options, product))
        self.externals = product.externals(structure)
        self._kernel = kernel(product.name, structure, self.externals, lambda: product.schedule(structure))
        self._lock = threading.Lock()
        self._own = {
            name: np.array(x, order="C")
            for name, x in parameters_of(chain, compiled.generic_rank).items()
            if name in self.externals
        }
        self._layout = ResultLayout(self.externals)
        self._addresses = Addresses(self.externals, self._own)

    def __call__(
        self, given: Mapping[str, Any], parameters: Mapping[str, Any], out: Derivative | None, threads: int
    ) -> Derivative:
        """Return the product, and forward dynamics beside it.

        Args:
            given: inputs, and what the product is taken with, by the names of `externals`.
            parameters: of this call, by the users' names.
            out: an earlier product to be written over.
            threads: how many threads share a batch.
        """
        compiled, chain = self._compiled, self._compiled.chain
        found = {
            name: arrays.floats(name.removeprefix(WITH), x, self.externals[name].shape) for name, x in given.items()
        }
        if parameters:
            found |= parse_parameters(parameters, self.externals, chain)
        batch = arrays.batch_of(found, self.externals)
        if not isinstance(threads, int) or threads < 1:
            raise StateError(f"threads: expected an integer >= 1, got {threads!r}")
        if out is None:
            result = CompiledResult(chain, self._layout, batch)
        else:
            checks.instance(out, Derivative, "out", StateError)
            result = out.result
            if result.layout is not self._layout:
                raise StateError("out: expected an earlier result of this very product; leave it out first")
            arrays.require_fit(result, chain, batch, list(found.values()))
        self._own["generic_rank"][...] = -1.0 if compiled.generic_rank is None else float(compiled.generic_rank)
        if batch is not None:
            self._kernel.run_batch(self._addresses.table(found, result), batch, threads)
            sound = not result.array("status").any()
        else:
            sound = self._single(found, result)
        if not sound:
            self._settle(found, result)
        return Derivative(result, self.product.wanted)

    def _single(self, found: Mapping[str, Array], result: CompiledResult) -> bool:
        """Run one system; return whether all is well."""
        with self._lock:
            self._bound.use({name: result.array(name) for name in self._layout.shapes})
            for name, x in (self._own | dict(found)).items():
                self._bound.arrays[name][...] = x
            self._bound.prepare()
            return self._bound.run() == 0

    def _settle(self, found: Mapping[str, Array], result: CompiledResult) -> None:
        """Decide open statuses; refuse derivatives of what is not unique, or leave them not-a-number in a batch."""
        own = self._own | dict(found)
        statuses.settle(self._compiled, own, result)
        if result.batch is None:
            statuses.require_answer(self._compiled, own, result)
        low = np.atleast_1d(result.array("status")) == INDETERMINATE
        names = self.product.given if self.product.backward else self.product.wanted
        choices = [name for name in names if name in NOT_UNIQUE]
        if not low.any() or not choices:
            return
        if result.batch is None:
            raise StateError(
                f"{choices[0]}: its derivative is that of one choice among the forces, which are not unique here; try"
                " the others (qdd, object_acceleration, contact_acceleration), whose derivatives along motions are"
            )
        lost = self.product.wanted if self.product.backward else choices
        for name in lost:
            result.array(f"{FOUND}{name}")[low] = np.nan

    @cached_property
    def _bound(self) -> Bound:
        return self._kernel.bind()


class ChainDerivatives:
    """The methods of a `CompiledChain` that are derivatives; machine code is made when first needed.

    Attributes:
        chain: the chain.
        options: what was chosen when it was compiled.
    """

    chain: ClosedChain
    options: Options

    def forward_dynamics_vjp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        by: Sequence[str] = STATE_AND_TORQUES,
        out: Derivative | None = None,
        threads: int = 1,
        **cotangents_and_parameters: Any,
    ) -> Derivative:
        """Return gradients of sum(cotangent . result) of forward dynamics: one more solve, O(n) + O(l).

        They are the partial derivatives of the map (q, qd, tau, object_pose, object_twist, ...) -> results as it
        stands, each argument varied by itself; along motions of the chain they do not depend on how it is continued
        beside the grasps. Poses turn by R -> exp(turn) R and shift: the object's and the bases' about their origins
        along world axes, those of grasps along the object's axes.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            by: the arguments whose gradients are wanted: q, qd, tau, object_pose, object_twist, object_wrench,
                gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist,
                base_acceleration, armature, damping, link_mass, link_com, link_inertia, link_wrench.
            out: an earlier product to be written over.
            threads: how many threads share a batch.
            **cotangents_and_parameters: cotangents of any of qdd (n,), grasp_wrench (arms, 6), object_acceleration
                (6,), contact_acceleration (n_g,), base_wrench (arms, 6), and parameters as in `forward_dynamics`.

        Returns:
            By argument its gradient, in its shape; of poses (.., 6) [turn; shift], of inertias symmetric. `result`
            is forward dynamics. In a batch, a system without an answer has not-a-number.

        Raises:
            StateError: wrong names, shapes or numbers; a cotangent of forces that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has a trunk, or springs between bodies.
        """
        cotangents, parameters = _apart(cotangents_and_parameters, RESULTS)
        if not cotangents:
            raise StateError(f"forward_dynamics_vjp: expected cotangents of some of {', '.join(RESULTS)}, got none")
        product = self._product(True, cotangents, by)
        given = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True))
        return product(given | {f"{WITH}{n}": x for n, x in cotangents.items()}, parameters, out, threads)

    def forward_dynamics_jvp(
        self,
        q: Any,
        qd: Any,
        tau: Any,
        object_pose: Any,
        object_twist: Any,
        *,
        along: Mapping[str, Any],
        of: Sequence[str] = RESULTS,
        out: Derivative | None = None,
        threads: int = 1,
        **parameters: Any,
    ) -> Derivative:
        """Return how fast the results of forward dynamics change while arguments do: one more solve, O(n) + O(l).

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            along: by argument, how fast it changes, of the shape that `forward_dynamics_vjp` returns for it; of one
                system (d, ...) for d directions at once, of a batch (batch, ...).
            of: the results whose rates are wanted.
            out: an earlier product to be written over.
            threads: how many threads share a batch.
            **parameters: as in `forward_dynamics`.

        Returns:
            By result how fast it changes, in its shape, with a leading axis of directions or systems if there is one.

        Raises:
            StateError: wrong names, shapes or numbers; forces are wanted that are not unique.
            SingularChainError: for a single call, the constraint's rank drops here.
            NotCompiledError: the chain has a trunk, or springs between bodies.
        """
        checks.instance(along, Mapping, "forward_dynamics_jvp: along", StateError)
        product = self._product(False, along, of)
        given = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True))
        return product(given | {f"{WITH}{n}": x for n, x in along.items()}, parameters, out, threads)

    def _product(self, backward: bool, given: Mapping[str, Any], wanted: Sequence[str]) -> CompiledProduct:
        """Return a product, compiled when first asked for."""
        what = f"forward_dynamics_{'vjp' if backward else 'jvp'}"
        if self.chain.trunk is not None or self.chain.springs:
            lacking = "a trunk" if self.chain.trunk is not None else "springs between bodies"
            raise NotCompiledError(f"compile: '{what}' of a chain with {lacking} is not there yet")
        checks.instance(wanted, (list, tuple), f"{what}: {'by' if backward else 'of'}", StateError)
        sides = (RESULTS, ARGUMENTS) if backward else (ARGUMENTS, RESULTS)
        for names, known in ((tuple(given), sides[0]), (tuple(wanted), sides[1])):
            if not names:
                raise StateError(f"{what}: expected some of {', '.join(known)}, got none")
            for name in names:
                if name not in known:
                    raise StateError(f"{what}: no {name!r}.{checks.did_you_mean(str(name), known)}")
        product = Product(
            backward,
            tuple(name for name in sides[0] if name in given),
            tuple(name for name in sides[1] if name in wanted),
        )
        made: dict[Product, CompiledProduct] = self.__dict__.setdefault("_products", {})
        if product not in made:
            made[product] = CompiledProduct(self, product)  # type: ignore[arg-type]
        return made[product]


def options_of(options: Options, product: Product) -> Options:
    """Return the options of a product: what it varies must be a run-time parameter."""
    arguments = product.wanted if product.backward else product.given
    return replace(
        options,
        link_inertia=options.link_inertia or any(name in LINKS for name in arguments),
        link_wrenches=options.link_wrenches or "link_wrench" in arguments,
        base_motion=options.base_motion or any(name in BASE_MOTION for name in arguments),
    )


def _apart(given: Mapping[str, Any], names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what is named, and the rest."""
    return {n: x for n, x in given.items() if n in names}, {n: x for n, x in given.items() if n not in names}
