"""Forward dynamics of forests by one elimination, whose order is data (docs/theory/tree.md)."""
