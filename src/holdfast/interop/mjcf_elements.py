"""What every element of MJCF does to the motion of an arm; an element without a row is noted by name.

MuJoCo's compiler resolves files, defaults and geoms, so most of what is `READ` is read from the compiled model.
"""

from __future__ import annotations

READ = (
    "mujoco", "mujocoinclude", "include", "compiler", "default", "worldbody", "body", "frame", "replicate", "attach",
    "model", "asset", "mesh", "inertial", "joint", "freejoint", "geom", "site", "contact", "equality", "tendon",
    "actuator", "extension",
)  # fmt: skip
# forces and settings that are not read; noted where they act on the arm
NOTED = (
    "option", "flag", "deformable", "flex", "flexcomp", "composite", "elasticity", "edge", "plugin", "general",
    "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle", "dcmotor", "adhesion",
)  # fmt: skip
# couplings; refused where they act on the arm
REFUSED = ("connect", "weld", "distance", "flexstrain", "flexvert", "fixed", "spatial", "pulley")
# inputs, sensors, contacts, pictures and sizes
NONE = (
    "motor", "exclude", "pair", "size", "statistic", "custom", "numeric", "text", "tuple", "element", "key",
    "keyframe", "visual", "global", "quality", "headlight", "map", "scale", "rgba", "texture", "material", "layer",
    "hfield", "skin", "bone", "camera", "light", "config", "instance", "lengthrange", "pin", "sensor",
    "accelerometer", "actuatorfrc", "actuatorpos", "actuatorvel", "ballangvel", "ballquat", "camprojection", "clock",
    "e_kinetic", "e_potential", "force", "frameangacc", "frameangvel", "framelinacc", "framelinvel", "framepos",
    "framequat", "framexaxis", "frameyaxis", "framezaxis", "fromto", "gyro", "insidesite", "jointactuatorfrc",
    "jointlimitfrc", "jointlimitpos", "jointlimitvel", "jointpos", "jointvel", "magnetometer", "normal",
    "rangefinder", "subtreeangmom", "subtreecom", "subtreelinvel", "tactile", "tendonactuatorfrc", "tendonlimitfrc",
    "tendonlimitpos", "tendonlimitvel", "tendonpos", "tendonvel", "torque", "touch", "user", "velocimeter",
)  # fmt: skip
EFFECTS = {
    **dict.fromkeys(READ, "read"),
    **dict.fromkeys(NOTED, "noted"),
    **dict.fromkeys(REFUSED, "refused"),
    **dict.fromkeys(NONE, "none"),
}
