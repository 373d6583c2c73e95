"""Arms on a common trunk: its motion, and the object's filter carried through its joints.

Everything here is about the origins of the trunk's bodies, along world axes.
"""
