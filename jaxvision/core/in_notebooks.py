"""Display a record in a notebook, with its numbers as an HTML table and with its picture."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PREVIEW = 320  # largest side of a picture in pixels
DOTS_PER_INCH = 64  # resolution of a figure


def record_html(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str = "",
    summary: str = "",
    notes: Iterable[str] = (),
) -> str:
    """Make an HTML table with a title above it, and a summary line and notes below it. All text is
    escaped."""

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = row(heads, "th") + "".join(row(cells, "td") for cells in rows)
    listed = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return (
        (f"<p><b>{escape(title)}</b></p>" if title else "")
        + f'<div style="overflow-x: auto"><table>{body}</table></div>'
        + (f"<p>{escape(summary)}</p>" if summary else "")
        + (f"<ul>{listed}</ul>" if listed else "")
    )


def picture_html(png: bytes, html: str, *, meaning: str) -> str:
    """Make HTML that shows a picture next to a table; `meaning` is the picture's alternative
    text."""
    data = base64.b64encode(png).decode()
    return (
        '<div style="display: flex; flex-wrap: wrap; gap: 1em">'
        f'<div><img alt="{escape(meaning)}" src="data:image/png;base64,{data}"></div>'
        f"<div>{html}</div></div>"
    )


def preview_png(pixels: np.ndarray) -> bytes:
    """Encode pixels, (h, w, 1 or 3) relative to white, as a PNG that is subsampled to at most 320
    pixels a side. NaN is black."""
    from matplotlib.image import imsave

    step = -(-max(pixels.shape[:2]) // PREVIEW)
    seen = np.clip(np.nan_to_num(pixels[::step, ::step]), 0, 1)
    file = io.BytesIO()
    codes = np.rint(255 * np.broadcast_to(seen, (*seen.shape[:2], 3))).astype(np.uint8)
    imsave(file, codes, format="png")
    return file.getvalue()


def figure_png(figure: "Figure") -> bytes:
    """Encode a figure as a small PNG, which a notebook shows next to a table."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DOTS_PER_INCH)
    return file.getvalue()
