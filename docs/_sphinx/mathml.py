"""Equations as MathML, made when the site is built: browsers show it without scripts and without network."""

from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

ACCENTS = {"¨", "˙", "~", "^"}
BARS = {"|", "\u2223"}


def setup(app: Any) -> dict[str, Any]:
    """Make MathML the site's way of showing equations."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True}


def inline(writer: Any, node: nodes.math) -> None:
    """Write an equation within a line."""
    writer.body.append(mathml(node.astext(), as_block=False))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write an equation on lines of its own."""
    writer.body.append(f'<div class="math">{mathml(node.astext(), as_block=True)}</div>\n')
    raise nodes.SkipNode


def mathml(tex: str, as_block: bool) -> str:
    """Return LaTeX as MathML, accents and bars put right.

    docutils puts the index of an accented letter below the letter (`munderover` of letter, index, accent), where
    it belongs beside them; and browsers draw true accents into tall letters, so they stand above instead. Bars
    become plain letters: as operators they would stretch and keep their distance.
    """
    tree = ElementTree.fromstring(str(tex2mathml(tex, as_block=as_block)).replace("&ApplyFunction;", "\u2061"))
    for element in list(tree.iter()):
        space, _, kind = element.tag.rpartition("}")
        if kind == "mo" and (element.text or "").strip() in BARS:
            element.tag, element.text = f"{space}}}mi", "|"
            element.attrib = {"mathvariant": "normal"}
        if kind not in ("mover", "munderover") or (element[-1].text or "").strip() not in ACCENTS:
            continue
        if kind == "mover":
            element.set("accent", "false")
            continue
        letter, index, accent = element
        element.tag = f"{space}}}msub"
        over = ElementTree.Element(f"{space}}}mover", {"accent": "false"})
        over.extend([letter, accent])
        element[:] = [over, index]
    ElementTree.register_namespace("", "http://www.w3.org/1998/Math/MathML")
    return ElementTree.tostring(tree, encoding="unicode")
