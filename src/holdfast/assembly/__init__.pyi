"""From arms, an object and grasps to a closed chain: where everything stands, and what is to be known about it."""

from .assemble import Assembly as Assembly
from .report import assembly_report as assembly_report
