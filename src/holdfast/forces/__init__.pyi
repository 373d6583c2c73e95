"""Forces at the grasps: margins, the split into motion and internal forces, loads of wrists."""

from .distribute import distribute as distribute
from .distribute import explain as explain
from .distribute import least_peak as least_peak
from .distribute import lift_margin as lift_margin
from .elastic_distribution import distribution_parameters as distribution_parameters
from .force_split import split as split
from .limits import Distribution as Distribution
from .limits import ForceCost as ForceCost
from .limits import ForceLimits as ForceLimits
from .margin_interval import largest_margin as largest_margin
from .margin_interval import margin_range as margin_range
from .margins import grasp_margins as grasp_margins
from .margins import joint_margins as joint_margins
from .wrist import last_joint_wrenches as last_joint_wrenches
from .wrist import wrist_wrenches as wrist_wrenches
