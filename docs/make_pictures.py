"""Make the pictures of the gallery by the commands that stand beside them, and tissue.png of the front page.

Run `python docs/make_pictures.py` with the extra `viz`, in an active environment. Each block of `gallery.md` runs in
one empty folder, in order; the picture `gallery/RUN-NAME.png` is then the file NAME.png in the folder RUN.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).parent
GALLERY = HERE / "gallery"
WIDTH = 1000  # pixels, of the gallery's pictures
HEIGHT, GAP = 460, 40  # pixels, of the front page's
FRONT = ("run-tissue.png", "run-scutoid.png")
BLOCK = re.compile(r"^```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"\(gallery/([a-z]+-[a-z0-9]+\.(?:png|gif))\)")


def main() -> None:
    """Run the blocks and keep the pictures."""
    page = (HERE / "gallery.md").read_text(encoding="utf-8")
    GALLERY.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        for language, code in BLOCK.findall(page):
            command = ["bash", "-ec", code] if language == "sh" else [sys.executable, "-c", code]
            subprocess.run(command, cwd=place, check=True)
        found = {name: Path(place, *name.split("-", 1)) for name in PICTURE.findall(page)}
        join([found[name] for name in FRONT])
        for name, path in found.items():
            if path.suffix == ".gif":
                (GALLERY / name).write_bytes(path.read_bytes())
            else:
                picture = Image.open(path).convert("RGB")
                size = WIDTH, round(picture.height * WIDTH / picture.width)
                picture.resize(size, Image.Resampling.LANCZOS).quantize(255).save(GALLERY / name, optimize=True)


def join(paths: list[Path]) -> None:
    """Make tissue.png of two pictures beside each other."""
    panels = [trim(Image.open(path)) for path in paths]
    joined = Image.new("RGB", (sum(panel.width for panel in panels) + GAP, HEIGHT), "white")
    joined.paste(panels[0], (0, 0))
    joined.paste(panels[1], (panels[0].width + GAP, 0))
    joined.quantize(255).save(HERE / "tissue.png", optimize=True)


def trim(picture: Image.Image) -> Image.Image:
    """A picture without its white border, scaled to the common height."""
    picture = picture.convert("RGB")
    rows, columns = np.nonzero((np.asarray(picture) < 250).any(axis=2))
    picture = picture.crop((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))
    return picture.resize((round(picture.width * HEIGHT / picture.height), HEIGHT), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main()
