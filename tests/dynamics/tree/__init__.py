"""The elimination of forests."""
