"""Rotation, pose, twist, wrench, inertia and small linear algebra on any scalar."""
