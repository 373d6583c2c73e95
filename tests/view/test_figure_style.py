"""Arms can be told apart, by colour or by line."""

from holdfast.view import figure_style
from holdfast.view.figure_style import arm_look, rgb


def test_arms_look_different():
    """Twenty arms differ; the first five even without their lines; danger and squeeze are nobody's colours."""
    looks = [arm_look(i) for i in range(20)]
    assert len(set(looks)) == 20
    assert len({colour for colour, _ in looks[:5]}) == 5
    assert not {colour for colour, _ in looks} & {figure_style.DANGER, figure_style.INTERNAL}


def test_rgb():
    """A colour's name in hexadecimal is its red, green and blue."""
    assert rgb("#0072B2") == (0, 114, 178)
