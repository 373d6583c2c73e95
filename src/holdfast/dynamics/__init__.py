"""The algorithms: open chain (`arm`), closed chain (`closed`), and what is asked of them."""
