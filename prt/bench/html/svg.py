"""Charts made fit to stand inside the page: nothing active, nothing from elsewhere, colours of the page.

Several charts share one document, so their ids get a prefix, and matplotlib's rule for all elements goes to
the page's own style sheet.
"""

import re
import xml.etree.ElementTree as ET

SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
#: what a drawing is made of; everything else, as scripts and links, is left out
ELEMENTS = frozenset(
    "svg g defs title desc path use circle ellipse rect line polyline polygon text tspan clipPath "
    "linearGradient radialGradient stop pattern mask symbol".split()
)
#: matplotlib's own colours, as the style sheet names them, so that charts follow light and dark
COLOURS = {
    "#ffffff": "--paper", "#fff": "--paper", "white": "--paper", "#000000": "--ink", "#000": "--ink",
    "black": "--ink", "#222222": "--ink", "#262626": "--ink", "#444444": "--soft", "#555555": "--soft",
    "#666666": "--soft", "#777777": "--soft", "#999999": "--faint", "#e6e6e6": "--line", "#cccccc": "--line",
    "#0072b2": "--blue",
}  # fmt: skip
_COLOUR = re.compile(r"(?<![\w#(-])(#[0-9a-fA-F]{3,8}|white|black)\b")
_URL = re.compile(r"url\(\s*['\"]?#([^)'\"]*)['\"]?\s*\)")


def prepare(text: str, prefix: str) -> str:
    """A chart's SVG without whatever could act or load, its ids begun with ``prefix``.

    Raises:
        ValueError: if it is no SVG.
    """
    try:
        root = ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"no SVG: {error}") from error
    if root.tag != f"{{{SVG}}}svg":
        raise ValueError("no SVG: its root is another element")
    _clean(root, prefix)
    for name in ("width", "height"):
        root.attrib.pop(name, None)
    ET.register_namespace("", SVG)
    return ET.tostring(root, encoding="unicode")


def has_points(prepared: str) -> bool:
    """Whether points of the chart say what they are."""
    return 'class="point"' in prepared


def _clean(node: ET.Element, prefix: str) -> None:
    for name, value in list(node.attrib.items()):
        del node.attrib[name]
        kept = _attribute(name, value, prefix)
        if kept is not None:
            node.attrib[kept[0]] = kept[1]
    drawn = node.tag.rpartition("}")[2]
    if drawn not in ("text", "tspan", "title", "desc"):
        node.text = None  # indentation
    node.tail = None if drawn != "tspan" else node.tail
    for child in list(node):
        if not isinstance(child.tag, str) or child.tag.removeprefix(f"{{{SVG}}}") not in ELEMENTS:
            node.remove(child)
        else:
            _clean(child, prefix)


def _attribute(name: str, value: str, prefix: str) -> tuple[str, str] | None:
    """The attribute as it stays, or None."""
    if name in ("href", f"{{{XLINK}}}href"):
        return ("href", f"#{prefix}{value[1:]}") if value.startswith("#") else None
    if name.startswith("{") or name.lower().startswith("on"):
        return None
    if name == "id":
        return name, prefix + value
    value = _URL.sub(rf"url(#{prefix}\1)", value)
    if re.search(r"url\((?!#)|expression|javascript:|@import|\\", value, re.IGNORECASE):
        return None
    if name in ("fill", "stroke"):  # variables are for styles alone
        return name, value
    return name, _COLOUR.sub(_themed, value) if name == "style" else value


def _themed(match: re.Match) -> str:
    known = COLOURS.get(match[1].lower())
    return f"var({known}, {match[1]})" if known else match[1]
