"""Files: problem cases, result folders."""
