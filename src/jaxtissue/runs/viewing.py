"""Pictures of the tissue in the folder of a run, and which cell they show."""

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxtissue.diagram.nearest import Crowd
from jaxtissue.diagram.point_location import label_points
from jaxtissue.exports.tissue_record import TissueRecord
from jaxtissue.geometry.domains import Domain
from jaxtissue.geometry.nodes import as_domain
from jaxtissue.geometry.tube import Tube
from jaxtissue.meshes.cell_meshes import CellMeshes, mesh_cells
from jaxtissue.meshes.straight_edges import straighten
from jaxtissue.pictures.domain_outsides import open_domain
from jaxtissue.pictures.movies import SMALLER, save_movie, turn_round
from jaxtissue.pictures.outsides import Face, cut_open
from jaxtissue.pictures.scenes import draw_bodies, draw_cells, draw_tissue, save, shades
from jaxtissue.runs import formats
from jaxtissue.runs.formats import picture_name
from jaxtissue.runs.pages import write_page
from jaxtissue.runs.plots import Tissue, plot_surfaces, save_figure, unrolls
from jaxtissue.system.extras import optional

LOOKED_AT = 1e-4  # the tolerance of meshes that are only looked at
CLOSELY = 4e-5  # and of those of a few cells
_ALIKE = 150  # so far apart in red, green and blue two colors are easily told apart
_SECONDS, _QUICK = 0.7, 0.12  # for each picture of a movie, and of a turntable


def view_tissue(tissue: TissueRecord, what: str, path: Path, cell: int | None = None) -> None:
    """Write a picture of a tissue: one of `VIEWS`, of the given cell where it is of one.

    Raises:
        ValueError: If PyVista is not installed, if the cell does not exist, or if the tissue has none such.
    """
    if cell is not None and not 0 <= cell < len(tissue.positions):
        raise ValueError(
            f"--cell {cell} is not one of the {len(tissue.positions)} cells; give 0 to {len(tissue.positions) - 1}"
        )
    VIEWS[what](tissue, path, cell)


def import_pictures() -> None:
    """Import what draws in three dimensions, if it is installed and something is to be drawn."""
    if formats.LEFT:
        optional("pyvista.plotting", "viz", "a picture in three dimensions")


def leave_pictures(
    tissue: TissueRecord, folder: Path, flat: bool = False, outside: Sequence[Face] | None = None
) -> None:
    """Leave the page of a run, and its pictures `formats.LEFT` unless all are to be flat.

    The `outside` of the tissue is computed if it is not given. Of a tissue without contacts only that is drawn.
    What can't be drawn is left out and told in a line. The page is written before, too: should the system's graphics
    end the process, it is there.
    """
    write_page(folder, () if flat else None)
    if flat:
        return
    drawn = []
    views = VIEWS | {"tissue": partial(_leave_whole, outside=outside)}
    for what in formats.LEFT:
        if what == "scutoid" and not (tissue.traced and tissue.traced.transitions.per_cell.any()):
            continue
        try:
            views[what](tissue, folder / picture_name(what), None)
            drawn.append(picture_name(what))
        except Exception as error:  # results do without
            warnings.warn(f"{picture_name(what)} is not drawn: {' '.join(str(error).split())}", stacklevel=2)
            break
    write_page(folder, drawn)


def find_scutoid(tissue: TissueRecord) -> int:
    """The cell that shows best what a scutoid is: with few transition points, at no end, nearest to the middle."""
    found = tissue.connectivity
    count, forms = found.transitions.per_cell, found.forms
    good = np.flatnonzero((count > 0) & ~found.is_end & ~forms.is_ring & (forms.pieces == 1))
    good = good if len(good) else np.flatnonzero(count > 0)
    if not len(good):
        raise ValueError("no cell of the tissue is a scutoid; use --what cell")
    aside = np.zeros(len(good))
    if isinstance(tissue.domain, Tube):
        aside = np.abs(np.asarray(tissue.positions)[good, 0] / float(tissue.domain.length) - 0.5)
    return int(good[np.argmin(np.maximum(count[good], 2) + aside)])


def _colors(tissue: TissueRecord) -> np.ndarray:
    return shades(len(tissue.positions), tissue.pairs)


def _mesh(tissue: TissueRecord, *cells: int) -> CellMeshes:
    return _straight(tissue, mesh_cells(tissue.positions, tissue.domain, CLOSELY, cells))


def _straight(tissue: TissueRecord, meshes: CellMeshes) -> CellMeshes:
    if not isinstance(tissue.domain, Tube):  # where cells are large on a curved surface, vertices would leave it
        return meshes
    label = partial(label_points, positions=tissue.positions, domain=tissue.domain)
    return straighten(meshes, Crowd(tissue.positions, as_domain(tissue.domain)), label)


def _draw_whole(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    save(draw_tissue(outside_of(tissue.positions, tissue.domain), _colors(tissue), tissue.unit), path)


def _leave_whole(tissue: TissueRecord, path: Path, cell: int | None, outside: Sequence[Face] | None) -> None:
    """The same from what a run has found: without contacts, cells that touch on the faces have other colors."""
    faces = outside or outside_of(tissue.positions, tissue.domain)
    pairs = tissue.traced.contacts.pairs if tissue.traced else np.concatenate([face.pairs() for face in faces])
    save(draw_tissue(faces, shades(len(tissue.positions), pairs), tissue.unit), path)


def outside_of(positions: Float[np.ndarray, "n d"], domain: Tube | Domain) -> list[Face]:
    """The outside of a tissue that is cut open."""
    if isinstance(domain, Tube):
        return cut_open(positions, domain)
    return open_domain(positions, domain)


def _draw_bodies(tissue: TissueRecord, path: Path, cell: int | None, apart: float = 0.0) -> None:
    save(draw_bodies(_straight(tissue, tissue.meshes), _colors(tissue), apart=apart, unit=tissue.unit), path)


def _draw_cell(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    own = len(tissue.positions) // 2 if cell is None else cell
    around = np.setdiff1d(tissue.pairs[(tissue.pairs == own).any(axis=1)], [own])
    meshes = _mesh(tissue, own, *around.tolist())
    save(draw_cells(meshes, _colors(tissue), [own], around.tolist(), unit=tissue.unit), path)


def _draw_scutoid(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    own, transitions = find_scutoid(tissue) if cell is None else cell, tissue.connectivity.transitions
    at = (transitions.cells == own).any(axis=1)
    if not at.any():
        raise ValueError(f"cell {own} has no transition point; remove --cell, or use --what cell")
    around = np.setdiff1d(transitions.cells[at], [own])
    meshes = _mesh(tissue, own, *around.tolist())
    save(draw_cells(meshes, _colors(tissue), [own], around.tolist(), transitions.points[at], tissue.unit), path)


def _draw_internal(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    contacts = tissue.connectivity.contacts
    inner = np.flatnonzero((contacts.kind == "internal") & (cell is None or (contacts.pairs == cell).any(axis=1)))
    if not len(inner):
        what = "the tissue" if cell is None else f"cell {cell}"
        raise ValueError(f"{what} has no internal neighbors, which touch on neither surface; use --what cell")
    pair = contacts.pairs[inner[np.argmax(contacts.area[inner])]]
    transitions = tissue.connectivity.transitions
    both = np.isin(transitions.cells, pair).sum(axis=1) == 2
    around = np.setdiff1d(transitions.cells[both], pair)
    shown = pair.tolist(), around.tolist()
    meshes, colors = _mesh(tissue, *shown[0], *shown[1]), _colors(tissue)
    away = np.linalg.norm(colors.astype(float) - colors[pair[0]], axis=1)
    if away[pair[1]] < _ALIKE:  # the same where eight colors do not suffice, or two blues
        colors[pair[1]] = colors[away.argmax()]
    save(draw_cells(meshes, colors, *shown, transitions.points[both], tissue.unit), path)


def _draw_surfaces(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    shown = Tissue("unrolled" if unrolls(tissue.domain) else "", tissue.positions, tissue.columns["volume"])
    save_figure(path, partial(plot_surfaces, tissue.domain, [shown]))


def _draw_movie(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    """The kept sweeps of a run, the cells in the colors of the last one."""
    if not tissue.history:
        raise ValueError("a movie needs the stored sweeps of a run of jaxtissue anneal; use --what tissue")
    colors, frames = _colors(tissue), []
    for _, positions in sorted(tissue.history.items()):
        plotter = draw_tissue(outside_of(positions, tissue.domain), colors, tissue.unit)
        frames.append(plotter.screenshot(return_img=True))
        plotter.close()
    save_movie(frames, path, _SECONDS)


def _draw_turntable(tissue: TissueRecord, path: Path, cell: int | None) -> None:
    plotter = draw_tissue(outside_of(tissue.positions, tissue.domain), _colors(tissue), None)
    save_movie(list(turn_round(plotter)), path, _QUICK, SMALLER)
    plotter.close()


VIEWS: dict[str, Callable[[TissueRecord, Path, int | None], None]] = {
    "tissue": _draw_whole,
    "bodies": _draw_bodies,
    "exploded": partial(_draw_bodies, apart=0.5),
    "cell": _draw_cell,
    "scutoid": _draw_scutoid,
    "internal": _draw_internal,
    "surfaces": _draw_surfaces,
    "movie": _draw_movie,
    "turntable": _draw_turntable,
}
