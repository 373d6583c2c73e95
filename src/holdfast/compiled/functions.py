"""The functions of a compiled chain besides forward dynamics; their machine code is made when first needed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, NoReturn

from holdfast.compiled import arrays
from holdfast.compiled.arm_functions import CLOSED
from holdfast.compiled.function import CompiledFunction
from holdfast.compiled.methods import ChainMethods
from holdfast.compiled.not_compiled import missing, require_holding
from holdfast.compiled.possible_motion import possible
from holdfast.dynamics.closure_derivatives import by_grasps
from holdfast.dynamics.consistency import GraspResidual
from holdfast.forces.margins import JointMargins
from holdfast.spatial.scalar import Array


class Frames(NamedTuple):
    """Poses of frames in the world.

    Attributes:
        R: (..., 3, 3) rotation matrices from the frames' axes to world axes.
        p: (..., 3) origins of the frames [m].
    """

    R: Array
    p: Array


class ChainFunctions(ChainMethods):
    """The methods of a `CompiledChain` besides forward dynamics and derivatives.

    All take one system or a batch: any argument or parameter may have a leading batch axis, and those without it are
    shared. Results do not depend on batch size or number of threads, bit for bit. If a number is not finite, an angle
    exceeds 1e5 rad or a quaternion is not of unit length, one system raises a `StateError`; in a batch, only the
    results of that system are NaN. Parameters must always be finite. An object_mass requires an object_inertia;
    "scale" scales the chain's own with the mass. With a floating base, functions of its pose require floating_pose
    (7,), and functions of velocities also floating_twist (6,). Functions that take base_twist also take
    trunk_base_twist (6,) if the chain has a trunk that does not float.
    """

    def inverse_dynamics(
        self, q: Any, qd: Any, qdd: Any, grasp_wrench: Any, *, threads: int = 1, **parameters: Any
    ) -> Array:
        """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), as `holdfast.inverse_dynamics`.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip [rad or m].
            qd: (n,) joint velocities [rad/s or m/s].
            qdd: (n,) joint accelerations [rad/s^2 or m/s^2].
            grasp_wrench: (arms, 6) wrench [moment; force] of each arm on the object about the contact point, world
                axes [N m, N]; rows of arms without a grasp must be zero, and those of bushings zero or what they exert.
            threads: the number of threads for a batch.
            **parameters: for this call, any of gravity (3,), base_pose (arms, 7), base_twist and
                base_acceleration (arms, 6), and the parameters added in `compile`. Chains with springs between bodies
                or bushings, whose forces depend on the object, require object_pose (7,) and object_twist (6,), those
                with a floating base floating_pose (7,), floating_twist and floating_acceleration (6,); bushings add
                grasp_pose (grasps, 7).

        Returns:
            (n,) joint torques [N m or N].

        Raises:
            StateError: A shape or number is wrong, an arm that holds nothing has a wrench, a bushing exerts another
                wrench, or a floating base would need a drive; in a batch, the results of such a system are NaN in the
                last two cases.
        """
        f = arrays.floats("grasp_wrench", grasp_wrench, (len(self.chain.arms), 6))
        require_holding(self.chain, f)
        found = self._function("inverse_dynamics")((q, qd, qdd, f), parameters, threads)
        return possible(self.chain, f, found)["tau"]

    def mass_matrix(self, q: Any, *, threads: int = 1, **parameters: Any) -> dict[str, Array]:
        """Return the joint mass matrix M of every arm, armature included: T = 1/2 qd^T M qd + ...

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            threads: how many threads share a batch.
            **parameters: the links' mass properties, if asked for in `compile`.

        Returns:
            By arm name, (N, N) symmetric [kg m^2, kg m, kg].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._matrices("mass_matrix", q, parameters, threads)

    def jacobian(self, q: Any, *, threads: int = 1, **parameters: Any) -> dict[str, Array]:
        """Return the Jacobian J of every arm's tip point: V = [omega; v] = J qd on a base at rest.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            threads: how many threads share a batch.
            **parameters: for this call, base_pose (arms, 7).

        Returns:
            By arm name, (6, N), world axes.

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._matrices("jacobian", q, parameters, threads)

    def closure(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, threads: int = 1, **parameters: Any
    ) -> dict[str, GraspResidual]:
        """Return the constraint residual of each grasp, as `holdfast.dynamics.closure`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            threads: how many threads share a batch.
            **parameters: for this call, any of base_pose (arms, 7), base_twist (arms, 6),
                grasp_pose (grasps, 7).

        Returns:
            By arm name, position rows in contact axes, first angles [rad] and then lengths [m], and velocity
            rows K (A V(C) - V+) [rad/s, m/s].

        Raises:
            StateError: wrong shapes or numbers.
        """
        found = self._function("closure")((q, qd, object_pose, object_twist), parameters, threads)
        return by_grasps(self.chain, **found)

    def kinetic_energy(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, threads: int = 1, **parameters: Any
    ) -> Any:
        """Return T = sum 1/2 V^T M V over links and object, plus 1/2 armature qd^2 of the actuators.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            threads: how many threads share a batch.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia
                (3, 3), base_pose (arms, 7), base_twist (arms, 6), and the links' if asked for.

        Returns:
            A number, or (batch,) [J].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._energy("kinetic_energy", (q, qd, object_pose, object_twist), parameters, threads)

    def potential_energy(self, q: Any, object_pose: Any, *, threads: int = 1, **parameters: Any) -> Any:
        """Return U = -sum m g . r over links and object, zero at the world's origin.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            object_pose: (7,) wxyz_xyz of the object frame.
            threads: how many threads share a batch.
            **parameters: for this call, any of gravity (3,), object_mass (), object_com (3,),
                object_inertia (3, 3), base_pose (arms, 7), and the links' if asked for.

        Returns:
            A number, or (batch,) [J].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._energy("potential_energy", (q, object_pose), parameters, threads)

    def joint_margins(self, q: Any, qd: Any, tau: Any, *, threads: int = 1, **parameters: Any) -> JointMargins:
        """Return the margins of all joints, as `holdfast.forces.joint_margins`; infinite without a limit.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: joint rates.
            tau: (n,) drive torques [N m or N].
            threads: how many threads share a batch.
            **parameters: none; limits are the chain's.

        Raises:
            StateError: wrong shapes or numbers.
        """
        return JointMargins(**self._function("joint_margins")((q, qd, tau), parameters, threads))

    def grasp_margins(self, object_pose: Any, grasp_wrench: Any, *, threads: int = 1, **parameters: Any) -> Array:
        """Return the margin of every grasp, as `holdfast.forces.grasp_margins`; infinite without a limit.

        Args:
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            grasp_wrench: (arms, 6) wrench of each arm on the object, as in `wrist_wrenches`.
            threads: how many threads share a batch.
            **parameters: for this call, grasp_pose (grasps, 7). Friction and wrench limits are the chain's.

        Returns:
            (grasps,) [N].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._function("grasp_margins")((object_pose, grasp_wrench), parameters, threads)["grasp_margins"]

    def wrist_wrenches(self, q: Any, grasp_wrench: Any, *, threads: int = 1, **parameters: Any) -> Array:
        """Return the grasp wrenches in tip axes, as `holdfast.forces.wrist_wrenches`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            grasp_wrench: (arms, 6) wrench [moment; force] of each arm on the object about the contact point, world
                axes [N m, N], as `forward_dynamics` returns it; rows of arms without a grasp must be zero.
            threads: how many threads share a batch.
            **parameters: for this call, base_pose (arms, 7).

        Returns:
            (arms, 6) [N m, N].

        Raises:
            StateError: wrong shapes or numbers, or an arm that holds nothing has a wrench.
        """
        f = arrays.floats("grasp_wrench", grasp_wrench, (len(self.chain.arms), 6))
        require_holding(self.chain, f)
        return self._function("wrist_wrenches")((q, f), parameters, threads)["wrist_wrenches"]

    def momentum(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, threads: int = 1, **parameters: Any
    ) -> Array:
        """Return [angular; linear] momentum of links and object about a world point, as `holdfast.dynamics.momentum`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            threads: how many threads share a batch.
            **parameters: for this call, any of about (3,) the point, by default the world's origin,
                object_mass (), object_com (3,), object_inertia (3, 3), base_pose (arms, 7),
                base_twist (arms, 6), and the links' if asked for.

        Returns:
            (6,), world axes [N m s, N s].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._function("momentum")((q, qd, object_pose, object_twist), parameters, threads)["momentum"]

    def centre_of_mass(self, q: Any, object_pose: Any, *, threads: int = 1, **parameters: Any) -> Array:
        """Return the mass centre of links and object, as `holdfast.dynamics.centre_of_mass`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            object_pose: (7,) wxyz_xyz of the object frame.
            threads: how many threads share a batch.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia
                (3, 3), base_pose (arms, 7), and the links' if asked for.

        Returns:
            (3,), world axes [m].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._function("centre_of_mass")((q, object_pose), parameters, threads)["centre_of_mass"]

    def object_mobility(self, q: Any, object_pose: Any, *, threads: int = 1, **parameters: Any) -> Array:
        """Return the closed chain's mobility at C, as `holdfast.dynamics.object_mobility`: alpha(C) changes by P w.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m], used as given.
            object_pose: (7,) wxyz_xyz of the object frame.
            threads: how many threads share a batch.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia
                (3, 3), base_pose (arms, 7), grasp_pose (grasps, 7), and the links' if asked for.

        Returns:
            (6, 6) symmetric, world axes about C.

        Raises:
            StateError: wrong shapes or numbers.
        """
        return self._function("object_mobility")((q, object_pose), parameters, threads)["object_mobility"]

    def tip_poses(self, q: Any, *, threads: int = 1, **parameters: Any) -> dict[str, Frames]:
        """Return the pose of every arm's tip frame in the world, as `holdfast.dynamics.tip_pose`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            threads: how many threads share a batch.
            **parameters: for this call, base_pose (arms, 7).

        Returns:
            By arm name, R (3, 3) from tip axes to world axes, and p (3,) the tip's origin [m].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return {
            arm: Frames(R[..., 0, :, :], p[..., 0, :])
            for arm, (R, p) in self._frames("tip_poses", q, parameters, threads)
        }

    def link_poses(self, q: Any, *, threads: int = 1, **parameters: Any) -> dict[str, Frames]:
        """Return the poses of every arm's link frames in the world, as `holdfast.dynamics.link_poses`.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            threads: how many threads share a batch.
            **parameters: for this call, base_pose (arms, 7).

        Returns:
            By arm name, base to tip, R (N, 3, 3) from link axes to world axes, and p (N, 3) the origins,
            which lie on the links' joints [m].

        Raises:
            StateError: wrong shapes or numbers.
        """
        return dict(self._frames("link_poses", q, parameters, threads))

    def project(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, threads: int = 1, **parameters: Any
    ) -> dict[str, Array]:
        """Return the state projected onto the grasp constraint, positions and velocities, in the kinetic metric.

        Positions are corrected by two iterations of `holdfast.project`, which remove the constraint residual of an
        integrator's step up to rounding; velocities are corrected once. Larger residuals are reduced but may remain;
        `closure` returns them.

        Args:
            q: (n,) or (batch, n) joint positions [rad or m].
            qd: joint rates.
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            threads: how many threads share a batch.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia (3, 3),
                base_pose (arms, 7), base_twist (arms, 6), grasp_pose (grasps, 7), and the links' if asked for.

        Returns:
            The arrays q, qd, object_pose and object_twist by name; also floating_pose and floating_twist if the chain
            has a floating base.

        Raises:
            StateError: wrong shapes or numbers.
        """
        found = self._function("project")((q, qd, object_pose, object_twist), parameters, threads)
        return {name.removeprefix(CLOSED): x for name, x in found.items()}

    def __getattr__(self, name: str) -> NoReturn:
        """Raise the error for a missing attribute; for a library function, it says why it is not compiled."""
        raise missing(name, self)

    def _function(self, name: str) -> CompiledFunction:
        """Return a compiled computation; it is compiled when first requested."""
        shown_as = name if self.progress else ""
        return self._code(name, name, lambda: CompiledFunction(name, self.chain, self.options, shown_as=shown_as))

    def _matrices(self, name: str, q: Any, parameters: Mapping[str, Any], threads: int) -> dict[str, Array]:
        function = self._function(name)
        found = function((q,), parameters, threads)[name]
        matrices = {}
        for arm, part in function.parts[name].items():
            N = self.chain.arms[arm].joint_count
            rows = N if name == "mass_matrix" else 6
            matrices[arm] = found[..., part].reshape(*found.shape[:-1], rows, N)
        return matrices

    def _frames(self, name: str, q: Any, parameters: Mapping[str, Any], threads: int) -> Iterator[tuple[str, Frames]]:
        function = self._function(name)
        found = function((q,), parameters, threads)["frame"]
        for arm, part in function.parts["frame"].items():
            frames = found[..., part].reshape(*found.shape[:-1], (part.stop - part.start) // 12, 12)
            yield arm, Frames(frames[..., :9].reshape(*frames.shape[:-1], 3, 3), frames[..., 9:])

    def _energy(self, name: str, given: tuple[Any, ...], parameters: Mapping[str, Any], threads: int) -> Any:
        found = self._function(name)(given, parameters, threads)["energy"]
        return found if found.ndim else float(found)
