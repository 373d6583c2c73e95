"""Built-in arms from published data, two mechanisms made of short arms, and the import of URDF files."""

from .built_in import HOME as HOME
from .built_in import ROBOTS as ROBOTS
from .descriptions import load_robot_description as load_robot_description
from .gen3 import gen3 as gen3
from .iiwa14 import iiwa14 as iiwa14
from .mechanisms import stewart_platform as stewart_platform
from .mechanisms import three_finger_hand as three_finger_hand
from .panda import panda as panda
from .ur5e import ur5e as ur5e
from .urdf import urdf_chain as urdf_chain
