"""The commands that write or draw the tissue of a run."""

from collections.abc import Callable
from typing import Any

from jaxtissue.runs.exporting import export_tissue
from jaxtissue.runs.run_folders import read_tissue
from jaxtissue.runs.viewing import LOOKED_AT, view_tissue
from jaxtissue.system.files import check_folder


def export(arguments: dict[str, Any]) -> int:
    """Write the tissue of a run in the formats of other programs."""
    folder = arguments["out"]
    check_folder(folder, arguments["force"])
    tissue = read_tissue(arguments["run"], arguments["unit"])
    spacing = arguments["spacing"] and tuple(arguments["spacing"])
    for path in export_tissue(tissue, folder, arguments["to"], spacing):
        print(path)
    return 0


def view(arguments: dict[str, Any]) -> int:
    """Draw the tissue of a run."""
    what = arguments["what"]
    path = arguments["out"] or arguments["run"] / f"{what}.{'gif' if what == 'movie' else 'png'}"
    if path.suffix != (".gif" if what == "movie" else ".png"):
        raise ValueError(f"--out {path} must end in {'.gif for a movie' if what == 'movie' else '.png'}; rename it")
    tissue = read_tissue(arguments["run"], arguments["unit"], LOOKED_AT)
    view_tissue(tissue, what, path, arguments["cell"])
    print(path)
    return 0


COMMANDS: dict[str, Callable[[dict[str, Any]], int]] = {"export": export, "view": view}
