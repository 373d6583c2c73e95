"""What the library covers: every kind of chain against every question that is asked of chains."""
