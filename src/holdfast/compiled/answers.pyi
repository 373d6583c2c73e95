"""The questions that a compiled chain answers; made by `make stubs` from `holdfast.questions`."""

from typing import Any

from holdfast.compiled.function import Function
from holdfast.compiled.result import CompiledResult
from holdfast.dynamics.consistency import GraspResidual
from holdfast.dynamics.kinematics import Frames
from holdfast.forces.elastic_distribution import ElasticDistribution
from holdfast.forces.margins import JointMargins
from holdfast.spatial.scalar import Array

class _CentreOfMass(Function):
    def __call__(
        self, q: Any, object_pose: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the mass centre of links and object.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia (3, 3), base_pose
                (arms, 7); those of the links, if `compile` was asked for them; with a floating base, required,
                floating_pose and what moves with it.

        Returns:
            (3,) mass centre, world axes [m]. As Array, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _Closure(Function):
    def __call__(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, GraspResidual]:
        """Return the constraint residuals of every grasp.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of base_pose (arms, 7), base_twist (arms, 6), grasp_pose (grasps, 7);
                with a floating base, required, floating_pose and what moves with it; with a trunk that stands
                trunk_base_twist.

        Returns:
            position: position residuals of all grasps along contact axes, angles first [rad, m]; velocity: velocity
            residuals of all grasps, K (A V(C) - V+) [rad/s, m/s]. As dict[str, GraspResidual], with a leading axis
            for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _Distribute(Function):
    def __call__(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, acceleration: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> ElasticDistribution:
        """Return the torques and grasp wrenches for an acceleration of the object under limits, with the least effort.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            acceleration: (6,) or (batch, 6) wanted [omega_dot; v_dot of C], world axes [rad/s^2, m/s^2].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of gravity (3,), object_mass (), object_com (3,), object_inertia (3, 3),
                object_wrench (6,), base_pose (arms, 7), base_twist (arms, 6), base_acceleration (arms, 6), grasp_pose
                (grasps, 7), effort_share (), demanded_margin (grasps,), least_normal (grasps,), most_normal
                (grasps,), effort_weight (n,), wish (arms, 6), wished_qdd (n,), force_scale (), wrench_weight (),
                acceleration_weight (), price (), barrier (); those of the links, if `compile` was asked for them;
                with a floating base, required, floating_pose and what moves with it; with a trunk that stands
                trunk_base_twist and trunk_base_acceleration.

        Returns:
            tau: (n,) torques of the drives [N m or N]; qdd: (n,) joint accelerations [rad/s^2 or m/s^2];
            grasp_wrench: (arms, 6) wrench [moment; force] of each arm on the object about the contact point, world
            axes [N m, N]; object_acceleration: (6,) [omega_dot; v_dot of C] of the object, world axes [rad/s^2,
            m/s^2]; violation: by how much limits give way; all but 0 where they can be kept [N]; missed: largest
            acceleration of a contact that its arm cannot follow, or of the object that gives way or that no wrenches
            of the grasps can give [m/s^2]; residual: of the optimality conditions, relative; joint_price: (n, 2)
            decrease of the cost per unit by which the limit of a joint's effort [N m, N] or acceleration [rad/s^2,
            m/s^2] is raised; grasp_price: (arms, 7) the same for friction, pressing, edge, force and moment rating,
            least and most normal force of each grasp [1/N]. As ElasticDistribution, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _ForwardDynamics(Function):
    def __call__(
        self, q: Any, qd: Any, tau: Any, object_pose: Any, object_twist: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> CompiledResult:
        """Return joint accelerations, the wrench at every grasp and the object's acceleration.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            tau: (n,) or (batch, n) joint torques [N m or N].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of object_wrench (6,), gravity (3,), object_mass (), object_com (3,),
                object_inertia (3, 3), base_pose (arms, 7), base_twist (arms, 6), base_acceleration (arms, 6),
                grasp_pose (grasps, 7); those of the links, if `compile` was asked for them; with a floating base,
                required, floating_pose and what moves with it; with a trunk that stands trunk_base_twist and
                trunk_base_acceleration.

        Returns:
            qdd: (n,) joint accelerations [rad/s^2 or m/s^2]; grasp_wrench: (arms, 6) wrench [moment; force] of each
            arm on the object about the contact point, world axes [N m, N]; object_acceleration: (6,) [omega_dot;
            v_dot of C] of the object, world axes [rad/s^2, m/s^2]; contact_acceleration: (freedoms,) accelerations
            along the freedoms of the grasps; base_wrench: (arms, 6) wrench of each base on its arm about the base's
            origin, world axes [N m, N]. As CompiledResult, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _GraspMargins(Function):
    def __call__(
        self, object_pose: Any, grasp_wrench: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the margin of every grasp: how far it is from slipping, lifting off or giving way.

        Args:
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            grasp_wrench: (arms, 6) or (batch, arms, 6) wrench [moment; force] of each arm on the object about the
                contact point, world axes [N m, N].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of grasp_pose (grasps, 7).

        Returns:
            (grasps,) margins of the grasps; infinite without a limit [N]. As Array, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _InverseDynamics(Function):
    def __call__(
        self, q: Any, qd: Any, qdd: Any, grasp_wrench: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the joint torques of a motion under given grasp wrenches, tau = M qdd + C + J^T f + damping qd + stiffness (q - rest).

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            qdd: (n,) or (batch, n) joint accelerations [rad/s^2 or m/s^2].
            grasp_wrench: (arms, 6) or (batch, arms, 6) wrench [moment; force] of each arm on the object about the
                contact point, world axes [N m, N].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of gravity (3,), base_pose (arms, 7), base_twist (arms, 6),
                base_acceleration (arms, 6); those of the links, if `compile` was asked for them; with a floating
                base, required, floating_pose and what moves with it; with a trunk that stands trunk_base_twist and
                trunk_base_acceleration.

        Returns:
            (n,) joint torques [N m or N]. As Array, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _Jacobian(Function):
    def __call__(
        self, q: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, Array]:
        """Return the Jacobian of every arm's tip point, [omega; v] = J qd on a base at rest, world axes.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of base_pose (arms, 7); with a floating base, required, floating_pose and
                what moves with it.

        Returns:
            Jacobians of the arms' tips, one after the other, by rows [1, m]. As dict[str, Array], with a leading axis
            for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _JointMargins(Function):
    def __call__(
        self, q: Any, qd: Any, tau: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> JointMargins:
        """Return the margins of all joints; infinite without a limit.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            tau: (n,) or (batch, n) joint torques [N m or N].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, none.

        Returns:
            position: (n,) distance to the nearer end of the range [rad or m]; rate: (n,) rate limit minus |qd| [rad/s
            or m/s]; effort: (n,) effort limit minus |tau| [N m or N]. As JointMargins, with a leading axis for a
            batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _KineticEnergy(Function):
    def __call__(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Any:
        """Return the kinetic energy of links and object, plus 1/2 armature qd^2 of the actuators.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia (3, 3), base_pose
                (arms, 7), base_twist (arms, 6); those of the links, if `compile` was asked for them; with a floating
                base, required, floating_pose and what moves with it; with a trunk that stands trunk_base_twist.

        Returns:
            kinetic energy [J]. As a number, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _LinkPoses(Function):
    def __call__(
        self, q: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, Frames]:
        """Return the poses of every arm's link frames in the world, base to tip; their origins lie on the joints.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of base_pose (arms, 7); with a floating base, required, floating_pose and
                what moves with it.

        Returns:
            axes to world axes by rows, then the origin, frame after frame [m]. As dict[str, Frames], with a leading
            axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _MassMatrix(Function):
    def __call__(
        self, q: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, Array]:
        """Return the joint mass matrix of every arm, armature included.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, none; those of the links, if `compile` was asked for them.

        Returns:
            joint mass matrices of the arms, one after the other, by rows [kg m^2, kg m, kg]. As dict[str, Array],
            with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _Momentum(Function):
    def __call__(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the momentum of links and object about a world point.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of about (3,), object_mass (), object_com (3,), object_inertia (3, 3),
                base_pose (arms, 7), base_twist (arms, 6); those of the links, if `compile` was asked for them; with a
                floating base, required, floating_pose and what moves with it; with a trunk that stands
                trunk_base_twist.

        Returns:
            (6,) [angular; linear] momentum about a world point, world axes [N m s, N s]. As Array, with a leading
            axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _ObjectMobility(Function):
    def __call__(
        self, q: Any, object_pose: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the closed chain's mobility at C.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia (3, 3), base_pose
                (arms, 7), grasp_pose (grasps, 7); those of the links, if `compile` was asked for them; with a
                floating base, required, floating_pose and what moves with it.

        Returns:
            (6, 6) mobility P at C, world axes: alpha(C) changes by P w. As Array, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _PotentialEnergy(Function):
    def __call__(
        self, q: Any, object_pose: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Any:
        """Return the potential energy of gravity and of all springs, zero at the world's origin.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of gravity (3,), object_mass (), object_com (3,), object_inertia (3, 3),
                base_pose (arms, 7); those of the links, if `compile` was asked for them; with a floating base,
                required, floating_pose and what moves with it.

        Returns:
            potential energy [J]. As a number, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _Project(Function):
    def __call__(
        self, q: Any, qd: Any, object_pose: Any, object_twist: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, Array]:
        """Return the state projected onto the grasp constraint, positions and velocities, in the kinetic metric.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            qd: (n,) or (batch, n) joint rates [rad/s or m/s].
            object_pose: (7,) or (batch, 7) wxyz_xyz of the object frame.
            object_twist: (6,) or (batch, 6) [omega; v of C] of the object, world axes [rad/s, m/s].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of object_mass (), object_com (3,), object_inertia (3, 3), base_pose
                (arms, 7), base_twist (arms, 6), grasp_pose (grasps, 7); those of the links, if `compile` was asked
                for them; with a floating base, required, floating_pose and what moves with it; with a trunk that
                stands trunk_base_twist.

        Returns:
            closed.q: (n,) closed: joint positions, arms in order, base to tip, a trunk's first [rad or m]; closed.qd:
            (n,) closed: joint rates [rad/s or m/s]; closed.object_pose: (7,) closed: wxyz_xyz of the object frame;
            closed.object_twist: (6,) closed: [omega; v of C] of the object, world axes [rad/s, m/s]. As dict[str,
            Array], with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _TipPoses(Function):
    def __call__(
        self, q: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> dict[str, Frames]:
        """Return the pose of every arm's tip frame in the world.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of base_pose (arms, 7); with a floating base, required, floating_pose and
                what moves with it.

        Returns:
            axes to world axes by rows, then the origin, frame after frame [m]. As dict[str, Frames], with a leading
            axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class _WristWrenches(Function):
    def __call__(
        self, q: Any, grasp_wrench: Any, *, out: Any = None, threads: int | None = None, **parameters: Any
    ) -> Array:
        """Return the grasp wrenches in tip axes, as force-torque sensors in the wrists measure them.

        Args:
            q: (n,) or (batch, n) joint positions, arms in order, base to tip, a trunk's first [rad or m].
            grasp_wrench: (arms, 6) or (batch, arms, 6) wrench [moment; force] of each arm on the object about the
                contact point, world axes [N m, N].
            out: an earlier answer with arrays, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.
            **parameters: for this call, any of base_pose (arms, 7); with a floating base, required, floating_pose and
                what moves with it.

        Returns:
            (arms, 6) wrench [moment; force] of each arm on the object across its tip frame, about the tip's origin,
            tip axes [N m, N]. As Array, with a leading axis for a batch.

        Raises:
            StateError: A name, shape or number is wrong, or the question has no answer.
        """

class Answers:
    """The questions as attributes."""

    centre_of_mass: _CentreOfMass
    closure: _Closure
    distribute: _Distribute
    forward_dynamics: _ForwardDynamics
    grasp_margins: _GraspMargins
    inverse_dynamics: _InverseDynamics
    jacobian: _Jacobian
    joint_margins: _JointMargins
    kinetic_energy: _KineticEnergy
    link_poses: _LinkPoses
    mass_matrix: _MassMatrix
    momentum: _Momentum
    object_mobility: _ObjectMobility
    potential_energy: _PotentialEnergy
    project: _Project
    tip_poses: _TipPoses
    wrist_wrenches: _WristWrenches
