"""An MJCF file cannot ask for more than a machine has."""

import pytest

from holdfast import SceneError, load_mjcf

pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'holdfast[mjcf]'")
ARM = """<mujoco>{}<worldbody><body name="bar"><joint name="hinge"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
{}</body></worldbody></mujoco>"""
COPY = '<replicate count="2000"><replicate count="2000"><site/></replicate></replicate>'


@pytest.mark.parametrize(
    ("before", "inside", "message"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]>', "", "DOCTYPE"),
        ("", COPY, "expected at most 10,000 copies of it (replicate), got 4e+06"),
        ('<asset><texture name="t" type="2d" builtin="flat" width="900000" height="900000"/></asset>', "", "texture"),
        ('<asset><hfield name="h" nrow="90000" ncol="90000" size="1 1 1 1"/></asset>', "", "hfield"),
        ('<size nuserdata="2000000000"/>', "", "expected counts up to 16,777,216, got 2e+09"),
        ('<include file="more.xml"/>', "", "more.xml:1: "),
    ],
)
def test_refused(before, inside, message, tmp_path):
    """By file, line and element, before MuJoCo makes room."""
    text = ARM.format(before, inside)
    if before.startswith("<!"):
        text = before + ARM.format("", "")
    (tmp_path / "arm.xml").write_text(text)
    (tmp_path / "more.xml").write_text(f"<mujoco><worldbody>{COPY}</worldbody></mujoco>")
    with pytest.raises(SceneError) as caught:
        load_mjcf(tmp_path / "arm.xml")
    assert message in str(caught.value)


def test_what_is_no_more_than_usual(tmp_path):
    """Some copies, a texture, an included file."""
    (tmp_path / "more.xml").write_text(
        '<mujoco><asset><texture name="t" type="2d" builtin="flat" width="64" height="64"/></asset></mujoco>'
    )
    (tmp_path / "arm.xml").write_text(
        ARM.format('<include file="more.xml"/>', '<replicate count="3"><site/></replicate>')
    )
    assert load_mjcf(tmp_path / "arm.xml", tip="bar").joint_count == 1
