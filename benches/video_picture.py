"""Draws docs/pictures/video.jpg: what arrives of a camera over 34 kB/s, as separate pictures and as video.

The bench `stream` makes it.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "video.jpg"
#: The size of one half, and the height of its caption.
HALF, CAPTION = (480, 360), 44
GAP = 8


def draw(halves: list[tuple[str, Path]]) -> None:
    """Draws frames beside each other, each with its caption."""
    width = (HALF[0] + GAP) * len(halves) - GAP
    picture = Image.new("RGB", (width, HALF[1] + CAPTION), "white")
    pen, font = ImageDraw.Draw(picture), ImageFont.load_default(19)
    for place, (caption, file) in enumerate(halves):
        left = place * (HALF[0] + GAP)
        with Image.open(file) as frame:
            picture.paste(frame.resize(HALF, Image.Resampling.LANCZOS), (left, CAPTION))
        pen.text((left + 6, 12), caption, "black", font)
    picture.save(PICTURE, quality=88, optimize=True)
