"""To and from other libraries: MuJoCo's MJCF, Pinocchio's orders, functions for SciPy and JAX."""

from .for_scipy import jacobian_operator as jacobian_operator
from .for_scipy import value_and_gradient as value_and_gradient
from .joint_order import angular_first as angular_first
from .joint_order import free_flyer as free_flyer
from .joint_order import linear_first as linear_first
from .joint_order import pinocchio_order as pinocchio_order
from .mjcf_reader import load_mjcf as load_mjcf
from .mjcf_reader import load_mjcf_arms as load_mjcf_arms
from .mjcf_reader import load_mjcf_trunk as load_mjcf_trunk
from .mjcf_writer import to_mjcf as to_mjcf
from .to_jax import to_jax as to_jax
