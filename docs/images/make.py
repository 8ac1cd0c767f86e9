"""Draw the pictures of the documentation: ``python docs/images/make.py``."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from PIL import Image

import mixseq
from mixseq.creature import walk_cycle
from mixseq.plots import contact_sheet, draw_segmentation

HERE = Path(__file__).parent
WIDTH = 1600  # pixels


def main() -> None:
    """Draw all pictures."""
    walk = walk_cycle()
    model = mixseq.fit(walk)
    labels = model.decomposition.part_of_face, model.decomposition.joint_of_face

    page = BytesIO()
    contact_sheet(page, walk, model.sample(fps=2 * walk.fps), *labels)
    _save(page, HERE / "demo.png")

    page = BytesIO()
    draw_segmentation(page, walk.points[0], walk.faces, *labels)
    _save(page, HERE / "parts.png")


def _save(page: BytesIO, path: Path) -> None:
    """Shrink a page to `WIDTH`, and to 86 levels of each colour, which no eye misses and PNG packs better."""
    picture = Image.open(page).convert("RGB")
    height = round(WIDTH * picture.height / picture.width)
    smaller = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
    smaller.point([3 * round(level / 3) for level in range(256)] * 3).save(path, optimize=True)


if __name__ == "__main__":
    main()
