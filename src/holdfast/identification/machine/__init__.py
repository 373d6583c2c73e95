"""Identification of the whole machine: bodies, drives, friction and sensors together, from a prior and recordings."""
