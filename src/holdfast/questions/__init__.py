"""Questions about a chain: the arrays that they take and return, their derivatives, and the table of all of them."""
