"""The commands that write or draw the tissue of a run."""

from collections.abc import Callable
from typing import Any

from jaxtissue.runs.exporting import export_tissue
from jaxtissue.runs.formats import IMAGES, MOVIES, OF_CELLS, picture_name
from jaxtissue.runs.pages import write_page
from jaxtissue.runs.run_folders import read_tissue
from jaxtissue.runs.viewing import LOOKED_AT, view_tissue
from jaxtissue.system.files import check_folder
from jaxtissue.system.locks import alone


def export(arguments: dict[str, Any]) -> int:
    """Write the tissue of a run in the formats of other programs."""
    folder = arguments["out"]
    if arguments["spacing"] and not set(IMAGES) & set(arguments["to"]):
        raise ValueError(f"--spacing applies to {' and '.join(IMAGES)} only; add one to --to, or remove --spacing")
    check_folder(folder, arguments["force"])
    tissue = read_tissue(arguments["run"], arguments["unit"])
    spacing = arguments["spacing"] and tuple(arguments["spacing"])
    for path in export_tissue(tissue, folder, arguments["to"], spacing):
        print(path)
    return 0


def view(arguments: dict[str, Any]) -> int:
    """Draw the tissue of a run."""
    what = arguments["what"]
    path = arguments["out"] or arguments["run"] / picture_name(what)
    endings = (".gif", ".mp4") if what in MOVIES else (".png",)
    if path.suffix not in endings:
        raise ValueError(f"--out {path} must end in {' or '.join(endings)} for --what {what}; correct it")
    if arguments["cell"] is not None and what not in OF_CELLS:
        raise ValueError(f"--cell is for --what {', '.join(OF_CELLS)}, not {what}; remove --cell")
    tissue = read_tissue(arguments["run"], arguments["unit"], LOOKED_AT)
    view_tissue(tissue, what, path, arguments["cell"])
    if not arguments["out"]:
        with alone(arguments["run"]):
            write_page(arguments["run"], [path.name])
    print(path)
    return 0


COMMANDS: dict[str, Callable[[dict[str, Any]], int]] = {"export": export, "view": view}
