"""Mesh files (STL, OBJ, Collada) of robots, which nobody vouches for: read with named errors, in bounded memory."""
