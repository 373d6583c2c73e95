"""Code for the robot: C source or object files of a chain's computations."""

from .export import export_c as export_c
