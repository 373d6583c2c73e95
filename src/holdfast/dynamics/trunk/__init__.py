"""Algorithms for arms on a common trunk: its motion, and the object's filter extended through its joints.

All quantities are about the origins of the trunk's bodies, and along world axes.
"""
