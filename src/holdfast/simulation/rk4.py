"""Where `rotation_vector_rate` was; see `runge_kutta`."""

from holdfast.simulation.runge_kutta import rotation_vector_rate as rotation_vector_rate
