"""Figures to files: PNG with a palette, and SVG whose text stays text."""

from __future__ import annotations

import io
import re
from typing import NamedTuple

from matplotlib.figure import Figure
from PIL import Image

_FONTS = "'DejaVu Sans', Verdana, sans-serif"
"""Verdana is as wide as DejaVu Sans, and there where the other is not."""
_DOCTYPE = re.compile(r"<!DOCTYPE[^>]*>\s*")
_TAG = re.compile(r"<[^>]*>")
_LONG_NUMBER = re.compile(r"-?\d+\.\d{3,}")


class Rendered(NamedTuple):
    """A figure as files."""

    png: bytes
    svg: bytes
    width: float
    """Inches."""

    def _repr_png_(self) -> bytes:
        return self.png


def render(figure: Figure) -> Rendered:
    """Return a figure as PNG and SVG, without date or version: equal figures give equal bytes."""
    png, svg = palette_png(figure), io.StringIO()
    # The layout is found by now; the second file gets the same.
    figure.set_layout_engine("none")
    figure.savefig(svg, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = _TAG.sub(_shorter, _DOCTYPE.sub("", svg.getvalue()))
    text = text.replace("'DejaVu Sans'", _FONTS)
    return Rendered(png, text.encode(), figure.get_figwidth())


def palette_png(figure: Figure, colours: int = 256) -> bytes:
    """Return a figure as PNG with a palette: all that a drawing needs, and a third of the size."""
    full, png = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="rgba")
    image = Image.frombytes("RGBA", figure.canvas.get_width_height(), full.getvalue()).convert("RGB")
    image.quantize(colours, dither=Image.Dither.NONE).save(png, format="png")
    return png.getvalue()


def _shorter(tag: re.Match[str]) -> str:
    """Round the coordinates in a tag to a hundredth of a point, which no printer shows; words stay."""
    return _LONG_NUMBER.sub(lambda number: f"{float(number[0]):.2f}".rstrip("0").rstrip("."), tag[0])
