"""Readers of untrusted mesh files (STL, OBJ, Collada), with named errors and bounded memory."""
