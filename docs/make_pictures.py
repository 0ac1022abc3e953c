"""Make tissue.png, the picture on the front page: a tube of epithelium, cut open, and one of its scutoids.

Run `python docs/make_pictures.py` with the extra `viz`.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

SIZES = ("--cells", "110", "--length", "22", "--apical-radius", "3", "--basal-radius", "8")
HEIGHT, GAP = 460, 40  # pixels


def main() -> None:
    """Anneal a tissue, which leaves both pictures, and join them."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        command = [sys.executable, "-m", "jaxtissue", "anneal", *SIZES, "--sweeps", "40", "--seed", "3"]
        subprocess.run([*command, "--out", folder], check=True)
        panels = [trim(Image.open(folder / name)) for name in ("tissue.png", "scutoid.png")]
    width = sum(panel.width for panel in panels) + GAP
    joined = Image.new("RGB", (width, HEIGHT), "white")
    joined.paste(panels[0], (0, 0))
    joined.paste(panels[1], (panels[0].width + GAP, 0))
    joined.quantize(255).save(Path(__file__).parent / "tissue.png", optimize=True)


def trim(picture: Image.Image) -> Image.Image:
    """A picture without its white border, scaled to the common height."""
    picture = picture.convert("RGB")
    rows, columns = np.nonzero((np.asarray(picture) < 250).any(axis=2))
    picture = picture.crop((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    return picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
