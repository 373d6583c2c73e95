"""Contacts of the held object with the world: Signorini's and Coulomb's laws in the object's mobility."""
