"""Compile the dynamics of one chain to machine code (`holdfast.compile`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING, Any, get_args, overload

from holdfast import outer
from holdfast.compiled.answers import Answers
from holdfast.compiled.bound import BoundFunction
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.forest import CompiledForest, CompiledMechanism
from holdfast.compiled.function import Function, NotCompiledError
from holdfast.compiled.structure import OPTIONAL, Options, optional_parameters, require_iterations, require_rank
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.consistency import CLOSURE
from holdfast.dynamics.energy import KINETIC
from holdfast.dynamics.forward import FORWARD_DYNAMICS
from holdfast.dynamics.inverse import INVERSE_DYNAMICS
from holdfast.dynamics.kinematics import MASS_MATRIX
from holdfast.dynamics.methods import method_named
from holdfast.dynamics.object_level import OBJECT_MOBILITY
from holdfast.dynamics.projection import PROJECT
from holdfast.errors import MethodNotApplicable
from holdfast.forces.elastic_distribution import DISTRIBUTE
from holdfast.forces.margins import GRASP_MARGINS
from holdfast.forces.wrist import WRISTS
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.model.serial_chain import answered_as_forest, require_machine_code, require_unused
from holdfast.names import called, unknown_attribute
from holdfast.questions.arrays import TOUCH_START
from holdfast.questions.question import QUESTIONS

if TYPE_CHECKING:
    from holdfast.codegen.export import ExportedCode

# One question of each file that declares some; the import adds all of them to `QUESTIONS`.
DECLARED = (
    *(CLOSURE, DISTRIBUTE, FORWARD_DYNAMICS, GRASP_MARGINS, INVERSE_DYNAMICS, KINETIC),
    *(MASS_MATRIX, OBJECT_MOBILITY, PROJECT, WRISTS),
)


@overload
def compile(chain: Forest, *, parameters: Sequence[str] = (), progress: bool | None = None) -> CompiledForest: ...


@overload
def compile(
    chain: ClosedChain,
    *,
    dtype: str = "float64",
    method: str = "auto",
    parameters: Sequence[str] = (),
    iterations: int | None = None,
    generic_rank: int | None = None,
    progress: bool | None = None,
) -> CompiledChain: ...


def compile(
    chain: ClosedChain | Forest,
    *,
    dtype: str = "float64",
    method: str = "auto",
    parameters: Sequence[str] = (),
    iterations: int | None = None,
    generic_rank: int | None = None,
    progress: bool | None = None,
) -> CompiledChain | CompiledForest:
    """Compile the dynamics of a chain, or of a forest, to machine code.

    Joints, link inertias and tip frames become constants of the code. Bases, grasp frames, the object's inertia and
    gravity are run-time parameters, so chains that differ only in these share their code. Code is cached on disk
    (`HOLDFAST_CACHE` is a folder, or `off`). It is made for this processor, or for the one that `HOLDFAST_CPU` names.

    Args:
        chain: arms, object and grasps. The numbers of a forest, or of a chain with branches, loops, couplings or
            several objects, all become constants; its only options are parameters=["link_wrench"] and `progress`.
        dtype: the number type; only `float64` is supported.
        method: how the inverse inertia at each arm's tip is computed: `recursive` (articulated-body recursion),
            `mass_matrix` (by factorisation), or `auto`, which chooses one for each arm.
        parameters: further run-time parameters: `link_inertia` (adds link_mass, link_com and link_inertia, and
            with a trunk trunk_link_mass, trunk_link_com and trunk_link_inertia of its bodies, a floating base first),
            `link_wrench` (external wrenches on the links) and `acceleration_limits` (of `distribute`).
        iterations: the number of iterations of `distribute`, by default 16; fewer take less time, and leave more
            residual.
        generic_rank: the rank of the grasp constraint away from singular configurations. If it is None, it is
            determined when it first matters.
        progress: whether to show that machine code is made, also that of derivatives, batches and other functions,
            which is made when they are first called. None: in a notebook or on a terminal, if it takes longer than a
            second; True: always, elsewhere as a line in the log; False: never.

    Returns:
        The chain's dynamics as functions of arrays, for one system or a batch; a `CompiledForest` of a forest, and a
        `CompiledMechanism` of a chain with branches, loops, couplings or several objects, have forward dynamics, its
        derivatives and inverse dynamics only.

    Raises:
        MethodNotApplicable: `method` or `dtype` is not available in machine code.
        CompileError: The machine code cannot be made on this computer.
    """
    if isinstance(chain, Forest) or answered_as_forest(chain):
        require_unused(dtype=dtype != "float64", method=method != "auto", iterations=iterations is not None)
        require_unused(generic_rank=generic_rank is not None)
        optional_parameters(parameters, "compile", known=("link_wrench",))
        of = CompiledForest if isinstance(chain, Forest) else CompiledMechanism
        compiled = of(chain, parameters, progress)  # type: ignore[arg-type]
        _ = compiled.function.calls
        return compiled  # pyright: ignore[reportReturnType]
    checks.instance(chain, ClosedChain, "compile: chain")
    require_machine_code(chain, "compile")
    require_rank(generic_rank, chain, "compile")
    checks.instance(method, str, "compile: method", MethodNotApplicable)
    if dtype != "float64":
        raise MethodNotApplicable(f"compile: dtype: expected float64, got {checks.short(dtype)}")
    if method not in ("sequential", *get_args(Route)):
        name = method_named(method).name
        raise MethodNotApplicable(
            f"compile: '{name}' runs as reference only; machine code is made of `sequential` (same answers). Try"
            " method='auto', 'recursive' or 'mass_matrix'"
        )
    route: Route = "auto" if method == "sequential" else method  # type: ignore[assignment]
    further = dict.fromkeys(name for question in QUESTIONS.values() for name in question.optional)
    options = optional_parameters(
        parameters, "compile", route, (*OPTIONAL, *further, *([TOUCH_START] if chain.touching is not None else []))
    )
    require_iterations(iterations)
    made = CompiledChain(chain, replace(options, iterations=iterations), generic_rank, progress)
    _ = made.forward_dynamics.calls
    return made


@called
class CompiledChain(Answers):
    """The dynamics of one chain as machine code; made by `holdfast.compile`.

    Every question in `holdfast.questions` is an attribute, a `Function` whose machine code is made when it is first
    asked for: `compiled.inverse_dynamics(q, qd, qdd, grasp_wrench)`, `compiled.inverse_dynamics.vjp(...)` and so on.

    Attributes:
        chain: the chain.
        options: the options with which it was compiled.
        generic_rank: the rank of the grasp constraint away from singular configurations, or None while unknown.
        progress: whether to show that machine code is made; see `compile`.
    """

    def __init__(
        self, chain: ClosedChain, options: Options, generic_rank: int | None, progress: bool | None = None
    ) -> None:
        self.chain, self.options, self.generic_rank, self.progress = chain, options, generic_rank, progress

    def __getattr__(self, name: str) -> Any:
        """Return the function of a question; raise an error that says why there is none."""
        question = None if name.startswith("_") else QUESTIONS.get(name)
        if question is None:
            raise missing(name, self)
        found = Function(self, question)
        return self.__dict__.setdefault(name, found)

    def __dir__(self) -> list[str]:
        """Return the names of attributes and questions."""
        return sorted({*super().__dir__(), *QUESTIONS})

    def forward_dynamics_vjp(self, *given: Any, **further: Any) -> CompiledDerivatives:
        """Return gradients of forward dynamics: `forward_dynamics.vjp`."""
        return self.forward_dynamics.vjp(*given, **further)

    def forward_dynamics_jvp(self, *given: Any, **further: Any) -> CompiledDerivatives:
        """Return rates of forward dynamics: `forward_dynamics.jvp`."""
        return self.forward_dynamics.jvp(*given, **further)

    def forward_dynamics_jacobian(self, *given: Any, **further: Any) -> CompiledDerivatives:
        """Return the Jacobian of forward dynamics: `forward_dynamics.jacobian`."""
        return self.forward_dynamics.jacobian(*given, **further)

    def bind(self, **arrays_or_parameters: Any) -> BoundFunction:
        """Return forward dynamics bound to fixed arrays: `forward_dynamics.bind`."""
        return self.forward_dynamics.bind(**arrays_or_parameters)

    def export(self, folder: str | PathLike[str], **options: Any) -> ExportedCode:
        """Write computations of the chain as C or object files that run without Python.

        Args:
            folder: the folder to which the files are written.
            **options: the keyword arguments of `holdfast.codegen.export_c`, such as name, functions and target;
                progress is by default that of `holdfast.compile`.

        Raises:
            HoldfastError: `holdfast.codegen.export_c` raised it.
        """
        return outer.export_c(self, folder, **{"progress": self.progress, **options})

    def __repr__(self) -> str:
        """Return a short description that names the chain."""
        return f"<CompiledChain of {self.chain!r}>"

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations of forward dynamics for one system, including its parameters'."""
        return self.forward_dynamics.calls.kernel.operation_count

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to unpickle the object: its machine code is loaded from the cache or compiled again."""
        return CompiledChain, (self.chain, self.options, self.generic_rank, self.progress)

    def set_generic_rank(self, generic_rank: int) -> None:
        """Store the generic rank, so that later calls can decide every status by themselves."""
        self.generic_rank = generic_rank


# The functions that a compiled chain does not have, with reasons; all others of the dynamics are its methods.
_ROUNDS = "it goes on for as many rounds as it takes"
_SINGULAR_VALUES = "it decides by singular values, which are NumPy's"
_OF_A_RESULT = "it reads one ForwardResult"
_OF_A_FOREST = "it is of a forest, not of a chain"

REASONS = {
    "close": f"{_ROUNDS}; where grasps are nearly closed try `project`, which takes two",
    "diagnose": f"{_SINGULAR_VALUES}; `forward_dynamics` gives rank, status and condition",
    "dynamics.attach": "another grasp is other code; compile the chain it returns",
    "dynamics.contact_attitudes": "it is a few products of one grasp; try `tip_poses`",
    "dynamics.forest_balance": _OF_A_FOREST,
    "dynamics.forest_close": _OF_A_FOREST,
    "dynamics.forest_diagnose": _OF_A_FOREST,
    "dynamics.forest_dynamics": f"{_OF_A_FOREST}; `forward_dynamics` is of the chain",
    "dynamics.forest_dynamics_jacobian": _OF_A_FOREST,
    "dynamics.forest_dynamics_jvp": _OF_A_FOREST,
    "dynamics.forest_dynamics_vjp": _OF_A_FOREST,
    "dynamics.forest_impulse": _OF_A_FOREST,
    "dynamics.forest_inverse_dynamics": f"{_OF_A_FOREST}; `inverse_dynamics` is of the chain",
    "dynamics.forest_linearise": _OF_A_FOREST,
    "dynamics.forest_simulate": _OF_A_FOREST,
    "dynamics.joint_mass_matrix": "it is of one arm; `mass_matrix` gives those of all arms",
    "dynamics.momentum_rate": _OF_A_RESULT,
    "dynamics.motion_basis": _SINGULAR_VALUES,
    "dynamics.object_inertia": "it refuses an object held fast, by eigenvalues; `object_mobility` is its inverse",
    "dynamics.power": f"{_OF_A_RESULT}; the systems of a rollout have their `work`",
    "dynamics.project_velocity": f"{_SINGULAR_VALUES}; `project` takes the velocities nearest in kinetic energy",
    "dynamics.release": "another grasp is other code; compile the chain it returns",
    "dynamics.solve_contacts": "it tries slower ways where the fixed number of steps fails, and decides a status",
    "dynamics.state_from_joints": "it is of rigid grasps only; try `tip_poses`",
    "dynamics.tip_jacobian": "it is of one arm; `jacobian` gives those of all arms",
    "dynamics.tip_pose": "it is of one arm; `tip_poses` gives those of all arms",
    "forces.distribution_parameters": "it makes the parameters with which `distribute` is called",
    "forces.explain": "it reads the words of one Distribution",
    "forces.least_peak": f"it is a report, with a proof: {_ROUNDS}; `distribute` takes a share of the effort limits",
    "forces.lift_margin": f"it is a report, with a proof: {_ROUNDS}; `distribute` answers for one acceleration",
    "forces.largest_margin": f"it is a convex programme: {_ROUNDS}",
    "forces.last_joint_wrenches": _OF_A_RESULT,
    "forces.margin_range": f"it is a convex programme: {_ROUNDS}",
    "forces.split": f"{_OF_A_RESULT}, and its length follows from where the contacts are",
    "linearise": _SINGULAR_VALUES,
    "regressor": "it is of the model's parameters, which machine code has as constants",
    "dynamics.inertial_parameters": "it is of a body, not of a chain",
    "touch": "it collides again for as many rounds as it takes; `forward_dynamics` has the forces of contacts at rest",
    "holding_torques": "it is a control law, made by `control.compile_law(control.holding_law(chain), chain)`",
}
_PATHS = {path.rpartition(".")[2]: path for path in REASONS}


def missing(name: str, of: object) -> AttributeError:
    """Return the error for an attribute that a compiled chain does not have."""
    if path := _PATHS.get(name):
        return NotCompiledError(
            f"compile: '{name}' runs as reference only: {REASONS[path]}. holdfast.{path} computes it from the chain"
        )
    return unknown_attribute(of, name)
