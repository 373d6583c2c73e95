"""The model: joints, links, arms, the held object, grasps and the closed chain, as frozen dataclasses."""
