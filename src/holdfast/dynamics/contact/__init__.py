"""Contacts of the object with the world: gaps, rows, the law of contact and impacts."""
