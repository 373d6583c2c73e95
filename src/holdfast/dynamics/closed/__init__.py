"""Closed-chain forward dynamics: the arms, the object and the grasps together.

Everything here is about the contact points and C, along world axes.
"""
