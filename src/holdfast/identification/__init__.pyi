"""Identification: payload, links, drives, friction and sensors, from what was recorded."""

from .assessment import Assessment as Assessment
from .assessment import assess as assess
from .base_parameters import base_parameters as base_parameters
from .identification import Identification as Identification
from .load_recording import load_recording as load_recording
from .machine.identify_machine import measurement_errors as measurement_errors
from .machine.prior import Prior as Prior
from .next_motion import next_motion as next_motion
from .recording import Recording as Recording
from .signals import SignalReport as SignalReport
from .signals import prepared as prepared
