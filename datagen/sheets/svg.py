"""SVG of a `Page`: for screens of any size, and for changing by hand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.sax.saxutils import escape

from codediffuser.datagen.sheets.page import CAP_HEIGHT, Outline, Page, Point, Round, Words

ANCHORS = {"left": "start", "center": "middle", "right": "end"}


def svg_bytes(page: Page) -> bytes:
    """Write a page; user units are points, and nothing in it depends on time or machine."""
    size = f"{_number(page.width)} {_number(page.height)}"
    width, height = size.split()
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}pt" height="{height}pt" '
        f'viewBox="0 0 {size}" xml:space="preserve" '
        'font-family="DejaVu Sans, Verdana, sans-serif">\n'
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>\n'
    )
    return (head + "\n".join(_elements(page)) + "\n</svg>\n").encode()


def _elements(page: Page) -> Iterator[str]:
    def flip(at: Point) -> Point:
        return (at[0], page.height - at[1])

    for mark in page.marks:
        match mark:
            case Outline():
                points = " ".join(f"{_number(x)},{_number(y)}" for x, y in map(flip, mark.points))
                tag = "polygon" if mark.closed else "polyline"
                yield f'<{tag} points="{points}" {_style(mark)}/>'
            case Round():
                x, y = flip(mark.center)
                dash = ' stroke-dasharray="5 3.5"' if mark.dashed else ""
                yield (
                    f'<circle cx="{_number(x)}" cy="{_number(y)}" r="{_number(mark.radius)}" '
                    f"{_style(mark)}{dash}/>"
                )
            case Words():
                yield _text(mark, flip(mark.at))


def _text(mark: Words, at: Point) -> str:
    x, y = at
    drop = mark.size * CAP_HEIGHT / 2
    turn = ""
    if mark.rotation_rad:
        degrees = _number(-math.degrees(mark.rotation_rad))
        turn = f' transform="rotate({degrees} {_number(x)} {_number(y)})"'
    weight = ' font-weight="bold"' if mark.bold else ""
    # With the length given, a viewer without DejaVu Sans still keeps titles on their spines.
    return (
        f'<text x="{_number(x)}" y="{_number(y + drop)}" font-size="{_number(mark.size)}" '
        f'fill="{mark.color}" text-anchor="{ANCHORS[mark.align]}" '
        f'textLength="{_number(mark.width)}" lengthAdjust="spacingAndGlyphs"{weight}{turn}>'
        f"{escape(mark.text)}</text>"
    )


def _style(mark: Outline | Round) -> str:
    stroke = f' stroke="{mark.stroke}" stroke-width="{_number(mark.width)}"' if mark.stroke else ""
    return f'fill="{mark.fill or "none"}"{stroke}'


def _number(value: float) -> str:
    """A micrometre is 0.003 points: three decimals lose nothing, and -0 is 0."""
    text = f"{value:.3f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
