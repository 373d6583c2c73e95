"""Import of models from SDF files, versions 1.6 to 1.12, as the links and joints of `holdfast.robots.urdf`.

A file is processed by `vocabulary` (what an element does), `values` (its numbers), `frames` (poses relative to others),
`joints` and `reader`. A joint whose child hangs on another joint already closes a loop.
"""
